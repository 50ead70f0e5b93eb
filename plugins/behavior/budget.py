"""Budget: whether a robot can afford a task and still get home, and which charger is free.

A task begins and continues only while the battery's guaranteed energy covers the remaining task and the path home from
its place. Both costs are at the 95 % bound of the robot's own estimate.
"""

import itertools
import math
from collections.abc import Sequence

import msgspec

from robrain.agent.environment import Environment
from robrain.plugins.behavior.travel import Travel
from robrain.plugins.skill.energy import EnergyInterface, Work
from robrain.plugins.skill.home import ChargerPlace, HomeInterface
from robrain.plugins.skill.planner import PlannerInterface
from robrain.plugins.unit.teammates import NearbyRobot
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.reasons import NeedsEnergy, sentence_of

CONFIDENCE = 0.95
NEAREST = 3
"""Number of chargers, nearest by straight line, whose paths are compared."""
SNAP_M = 0.8
"""Largest distance of a path's start from the place, if the robot cannot stand there."""
DETOUR = 1.5
"""Assumed ratio of an unknown path's length to the straight line. Chosen."""
REQUIRES = ("energy", "home", "planner")
"""Requirements of a behavior with a budget, in its manifest, beside those of travel."""
AT_DOCK_M = 0.5
"""A robot within this distance of a charger, or bound for a place that near, occupies it. Two chargers are never nearer
to each other."""
RECHARGES = "recharge"
"""Behavior name of a robot that charges or wants to charge."""


class BudgetVerdict(msgspec.Struct, frozen=True):
    """Required and available energy, in joules at the battery's terminals."""

    needed_j: float
    """95 % bound of the task and the path home."""
    usable_j: float
    duration_s: float
    """Of the task, without the path home."""

    @property
    def is_affordable(self) -> bool:
        """Whether there is enough."""
        return self.usable_j >= self.needed_j

    @property
    def reason(self) -> NeedsEnergy:
        """Reason for a refusal if it is not affordable."""
        return NeedsEnergy(round(self.needed_j, 3), round(self.usable_j, 3))

    @property
    def words(self) -> str:
        """The same in words.

        >>> BudgetVerdict(5200.4, 4800.0, 60.0).words
        'needs 5200 J of 4800 J usable'
        """
        return sentence_of(self.reason)


class Budget:
    """Energy budget of a behavior; made in its `init`, connected in its `activate`.

    Args:
        env: the behavior's environment.
        travel: the behavior's, for the map as it is.

    """

    def __init__(self, env: Environment, travel: Travel) -> None:
        self._env = env
        self._travel = travel

    def connect(self) -> None:
        """Connect the plugins that it needs.

        Raises: PluginMissing, AccessDenied, PluginBusy: it is not available.

        """
        self.energy = self._env.use("energy", EnergyInterface)
        self.home = self._env.use("home", HomeInterface)
        self._planner = self._env.use("planner", PlannerInterface)
        self.docks = Docks(self._env.robot, self._travel)

    def judge(self, work: Work, home_m: float) -> BudgetVerdict:
        """Whether this work and then a path home of this length are affordable now."""
        bound_j = self.energy.estimate(work + Work(path_m=home_m)).high_j(CONFIDENCE)
        return BudgetVerdict(bound_j, self.energy.usable_j(), self.energy.estimate(work).duration_s)

    def path_home(self, place: Point2D) -> tuple[ChargerPlace | None, float]:
        """The nearest charger and the path length to it from a place; without one, None and the length to the start.

        A free charger is preferred. If the map shows no path, the length is 1.5 times the straight line. It is 0 while
        the start is unknown.
        """
        chargers = self.home.chargers()
        if chargers:
            free = self.docks.free(chargers) or chargers
            return min(self.routes(place, free), key=lambda route: route[1])
        start = self.home.start()
        return None, 0.0 if start is None else self.path_m(place, start)

    def routes(self, place: Point2D, chargers: Sequence[ChargerPlace]) -> list[tuple[ChargerPlace, float]]:
        """The chargers nearest to a place by straight line, each with the length of the path to it."""
        nearest = sorted(chargers, key=lambda charger: place.distance_m(charger.place))[:NEAREST]
        return [(charger, self.path_m(place, charger.place)) for charger in nearest]

    def lengths_m(self, start: Point2D, goals: Sequence[Point2D]) -> list[float]:
        """Lengths of the paths from a place to others, by the map, to compare them; inf where there is none."""
        grid = self._planner.grid(self._travel.view())
        cells = [grid.geometry.cell_of(goal.x_m, goal.y_m) for goal in goals]
        return grid.costs_m(start, cells, snap_m=SNAP_M)

    def path_m(self, start: Point2D, goal: Point2D) -> float:
        """Length of the path between two places by the map; without one, 1.5 times the straight line."""
        path = self.path(start, goal)
        # A path ends at the nearest place to its goal where the robot can stand.
        return length_m([start, *path]) if path else DETOUR * start.distance_m(goal)

    def path(self, start: Point2D, goal: Point2D) -> list[Point2D] | None:
        """A path between two places by the map, through narrow places if necessary; None if there is none."""
        view = self._travel.view()
        return self._planner.plan(view, start, goal, []) or self._planner.plan(view, start, goal, [], is_narrow=True)


def length_m(points: Sequence[Point2D]) -> float:
    """Length of a polyline.

    >>> length_m([Point2D(0.0, 0.0), Point2D(3.0, 4.0), Point2D(3.0, 5.0)])
    6.0
    """
    return sum(math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) for one, other in itertools.pairwise(points))


class Docks:
    """Occupancy of the chargers by present and approaching robots, without an arbiter.

    Of two robots bound for the same charger, the nearer one has it; of two equally near, the first by name.

    Args:
        robot: the robot's name.
        travel: provides the robot's pose and its teammates.

    """

    def __init__(self, robot: str, travel: Travel) -> None:
        self._robot = robot
        self._travel = travel

    def holder(self, place: Point2D) -> str:
        """Name of the robot that is at the charger at this place, or will be there before this robot; empty if none."""
        mine = (self._travel.pose().distance_m(place), self._robot)
        for teammate in self._travel.teammates.nearby(place, AT_DOCK_M):
            away_m = teammate.pose.distance_m(place)
            if away_m <= AT_DOCK_M < mine[0]:
                return teammate.name
            is_bound_here = teammate.bound.distance_m(place) <= AT_DOCK_M
            if is_bound_here and (away_m, teammate.name) < mine:
                return teammate.name
        return ""

    def free(self, chargers: Sequence[ChargerPlace]) -> list[ChargerPlace]:
        """The free ones of these."""
        return [charger for charger in chargers if not self.holder(charger.place)]

    def waiting(self, chargers: Sequence[ChargerPlace]) -> list[NearbyRobot]:
        """Teammates that want to charge and have no charger."""
        near = self._travel.teammates.nearby(self._travel.place(), self._travel.teammate_near_m)
        return [teammate for teammate in near if teammate.behavior == RECHARGES and not _has_one(teammate, chargers)]

    def charging(self, chargers: Sequence[ChargerPlace]) -> list[NearbyRobot]:
        """Teammates at a charger."""
        found = {
            teammate.name: teammate
            for each in chargers
            for teammate in self._travel.teammates.nearby(each.place, AT_DOCK_M)
            if teammate.pose.distance_m(each.place) <= AT_DOCK_M
        }
        return list(found.values())


def _has_one(teammate: NearbyRobot, chargers: Sequence[ChargerPlace]) -> bool:
    pose, bound = teammate.pose, teammate.bound
    return any(min(pose.distance_m(at), bound.distance_m(at)) <= AT_DOCK_M for at in (each.place for each in chargers))
