"""The auction, with PyVRP to improve its plans; read without PyVRP."""

from robrain.algorithms.allocation.allocator import Allocator
from robrain.algorithms.allocation.auction import AuctionAllocator


class SearchedAuction(AuctionAllocator):
    """The auction, with PyVRP to improve its plans."""

    def search(self) -> Allocator | None:
        """See `Searching`."""
        try:
            from robrain.algorithms.allocation.optimal import OptimalAllocator
        except ImportError:  # PyVRP comes with the extra `team`
            return None
        return OptimalAllocator(self.objective, lambda: 0.0)  # without a deadline the clock is not read
