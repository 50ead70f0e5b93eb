"""The allocators by name: `[planning] method` of a scenario or a planning file chooses one."""

from collections.abc import Callable
from typing import Final

from robrain.coordinator.allocation.allocator import Allocator
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.registry import Registry

OPTIMAL: Final = "optimal"
"""An auction, improved by a search."""
AUCTION: Final = "auction"
GREEDY: Final = "greedy"

ALLOCATORS: Registry[Callable[[Objective], Allocator]] = Registry(
    "method",
    "robrain.allocators",
    {
        OPTIMAL: "robrain.coordinator.allocation.searched_auction:SearchedAuction",
        AUCTION: "robrain.coordinator.allocation.auction:AuctionAllocator",
        GREEDY: "robrain.coordinator.allocation.auction:GreedyAllocator",
    },
)
"""Each makes an allocator for an objective."""
