"""Exploration strategies by name: which idle robot is sent to which frontier.

`[planning] exploration` of a scenario or a planning file chooses one. One of another distribution is checked: if it
fails, or chooses what it may not, that is counted and told, and `assignment` stands in.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.exploration.assignment import Candidate, Choice, Seeker, assign
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.registry import Registry

ASSIGNMENT: Final = "assignment"
"""One frontier each, at the least sum of path costs less what the frontiers promise."""
NEAREST_FRONTIER: Final = "nearest_frontier"
"""Each robot in turn the one nearest to it; a baseline."""


class Strategy(Protocol):
    """Sends idle robots to frontiers."""

    def __call__(
        self,
        ways_m: NDArray[np.float64],
        candidates: Sequence[Candidate],
        seekers: Sequence[Seeker],
        taken: Sequence[Point2D],
        *,
        is_narrow: bool = False,
    ) -> list[Choice]:
        """Choose; equal arguments give equal choices.

        Args:
            ways_m: (robots, frontiers) path cost, metres of open floor; infinite where there is no path.
            candidates: the frontiers.
            seekers: the idle robots, each with the places that it is not to be sent to now.
            taken: goals of the other robots, arena frame.
            is_narrow: whether the paths have less than the preferred clearance; copied into each choice.

        """
        ...


STRATEGIES: Registry[Strategy] = Registry(
    "exploration",
    "robrain.exploration_strategies",
    {
        ASSIGNMENT: "robrain.coordinator.exploration.assignment:assign",
        NEAREST_FRONTIER: "robrain.coordinator.exploration.assignment:nearest_frontier",
    },
)


def strategy_of(name: str, on_failure: Callable[[str, str], None]) -> Strategy:
    """The strategy of a name; one of another distribution is checked each time.

    Args:
        name: as in `STRATEGIES`.
        on_failure: told the name and why, whenever a foreign strategy fails or chooses what it may not.

    Raises:
        UnknownEntry: there is none of this name, or it cannot be imported.

    """
    strategy = STRATEGIES.get(name)
    return strategy if STRATEGIES.is_stock(name) else _checked(name, strategy, on_failure)


def _checked(name: str, strategy: Strategy, on_failure: Callable[[str, str], None]) -> Strategy:
    def choose(
        ways_m: NDArray[np.float64],
        candidates: Sequence[Candidate],
        seekers: Sequence[Seeker],
        taken: Sequence[Point2D],
        *,
        is_narrow: bool = False,
    ) -> list[Choice]:
        try:
            made = list(strategy(ways_m.copy(), tuple(candidates), tuple(seekers), tuple(taken), is_narrow=is_narrow))
            if why := _why_bad(made, ways_m, candidates, seekers):
                raise ValueError(why)
        except Exception as error:  # noqa: BLE001 - foreign code
            on_failure(name, f"{type(error).__name__}: {error}")
            return assign(ways_m, candidates, seekers, taken, is_narrow=is_narrow)
        return made

    return choose


def _why_bad(
    made: Sequence[object], ways_m: NDArray[np.float64], candidates: Sequence[Candidate], seekers: Sequence[Seeker]
) -> str:
    """What is wrong with some choices, in words; empty if nothing is."""
    rows = {seeker.name: row for row, seeker in enumerate(seekers)}
    columns = {candidate.place: column for column, candidate in enumerate(candidates)}
    robots: set[str] = set()
    places: set[Point2D] = set()
    for choice in made:
        if not isinstance(choice, Choice):
            return f"expected choices, got {type(choice).__name__}"
        if choice.robot not in rows or choice.robot in robots:
            return f"{choice.robot} is not idle, or is chosen twice"
        if choice.place not in columns or choice.place in places:
            return f"{choice.robot} is sent to what is no frontier, or is another's"
        if not math.isfinite(ways_m[rows[choice.robot], columns[choice.place]]):
            return f"{choice.robot} has no path to its frontier"
        robots.add(choice.robot)
        places.add(choice.place)
    return ""
