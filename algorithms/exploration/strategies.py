"""Exploration strategies by name: which idle robot is sent to which frontier.

`[planning] exploration` of a scenario or a planning file chooses one. One of another distribution is checked: if it
fails, or chooses what it may not, that is counted and reported with the line of its file, and `joint` stands in. A
lockstep run ends with the failure.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from robrain.algorithms.exploration.joint import joint
from robrain.algorithms.exploration.situation import Choice, Situation
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.registry import Registry, failure_text

NEAREST: Final = "nearest"
"""Each robot in turn the frontier nearest to it (Yamauchi 1998)."""
MINPOS: Final = "minpos"
"""Each robot the frontier to which the fewest robots are nearer (Bautin and others 2012)."""
BURGARD: Final = "burgard"
"""The best pair of utility and cost, again and again, utilities lowered near what was given away (2005)."""
JOINT: Final = "joint"
"""One frontier each, at the least sum of path costs less what the frontiers promise."""

TOURS: Final = "tours"
"""Tours through all frontiers that reach much unknown floor early; each robot begins its own."""

ROOMS: Final = "rooms"
"""Tours that know rooms, the work behind each frontier, and the ways of the other robots."""

AUTO: Final = "auto"
"""The default: `tours` for up to four robots, or `rooms` for three and four where rooms are small; `joint` for more."""


NO_EXPLORATION: Final = "none"
"""Robots explore only if a task tells them to."""


class Strategy(Protocol):
    """Sends idle robots to frontiers."""

    def __call__(self, situation: Situation) -> list[Choice]:
        """Choose at most one frontier for each seeker; equal situations give equal choices."""
        ...


BASELINES = "robrain.algorithms.exploration.baselines"
STRATEGIES: Registry[Strategy] = Registry(
    "exploration",
    "robrain.exploration_strategies",
    {
        AUTO: "robrain.algorithms.exploration.auto:auto",
        NEAREST: f"{BASELINES}:nearest",
        MINPOS: f"{BASELINES}:minpos",
        BURGARD: f"{BASELINES}:burgard",
        JOINT: "robrain.algorithms.exploration.joint:joint",
        TOURS: "robrain.algorithms.exploration.tours:tours",
        ROOMS: "robrain.algorithms.exploration.tours:rooms",
    },
    has_files=True,
)


def strategy_of(name: str, on_failure: Callable[[str, str], None]) -> Strategy:
    """The strategy of a name; one of another distribution is checked each time.

    Args:
        name: as in `STRATEGIES`.
        on_failure: told the name and why, whenever a foreign strategy fails or chooses what it may not.

    Raises:
        UnknownEntry: there is none of this name, or it cannot be imported.

    """
    if name == NO_EXPLORATION:
        return lambda _situation: []
    strategy = STRATEGIES.get(name)
    return strategy if STRATEGIES.is_stock(name) else _checked(name, strategy, on_failure)


def _checked(name: str, strategy: Strategy, on_failure: Callable[[str, str], None]) -> Strategy:
    def choose(situation: Situation) -> list[Choice]:
        try:
            made: object = strategy(situation)
            if not isinstance(made, list):
                raise TypeError(f"expected a list of Choice, got {type(made).__name__}")
            if why := _choices_refusal(made, situation):
                raise ValueError(why)
        except Exception as error:  # noqa: BLE001 - foreign code
            on_failure(name, failure_text(strategy, error))
            return joint(situation)
        return made

    return choose


def _choices_refusal(made: Sequence[object], situation: Situation) -> str:
    """What is wrong with some choices, in words; empty if nothing is."""
    rows = {seeker.name: row for row, seeker in enumerate(situation.seekers)}
    columns = {candidate.place: column for column, candidate in enumerate(situation.candidates)}
    robots: set[str] = set()
    places: set[Point2D] = set()
    for choice in made:
        if not isinstance(choice, Choice):
            return f"expected a list of Choice, got one of {type(choice).__name__}"
        place: object = choice.place
        cost_m: object = choice.cost_m
        if not isinstance(place, Point2D):
            return f"expected the place of {choice.robot} to be a Point2D, got {type(place).__name__}"
        if not isinstance(cost_m, float | int) or not math.isfinite(cost_m):
            return f"expected a finite cost_m for {choice.robot}, got {cost_m!r}"
        if choice.robot not in rows or choice.robot in robots:
            return f"{choice.robot} is not idle, or is chosen twice"
        if choice.place not in columns or choice.place in places:
            return f"{choice.robot} is sent to what is no frontier, or is another's"
        if not math.isfinite(situation.ways_m[rows[choice.robot], columns[choice.place]]):
            return f"{choice.robot} has no path to its frontier"
        robots.add(choice.robot)
        places.add(choice.place)
    return ""
