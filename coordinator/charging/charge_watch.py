"""Collects the robots that charge, drive to a charger, or should charge, as the input of the schedule."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from robrain.coordinator.charging.charge_schedule import Seeker, Way, is_same_charger
from robrain.coordinator.charging.charge_turns import TO_SOC, nearest
from robrain.coordinator.charging.chargers import Charger
from robrain.coordinator.planning.energy_budget import CHARGED_SHARE, SOC_LEAST, profile_of
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.snapshot_builder import is_charging
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.model.energy.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, Recharge
from robrain.protocol.model.tasks.task import parameters_of
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.messages.robots.robot_messages import BatteryState
from robrain.protocol.wire.messages.tasks.task_messages import TaskRecord

USUAL_W = 20.0
"""Of a charger at which no robot has charged yet. Chosen: a dock of 40 W, less a small robot's own consumption and the
slower last part of a charge."""
LEAST_W = 1.0
"""Lower bound of a learned power, so that every charge has an end."""
WINDOW_NS = to_ns(10.0)
"""Interval over which the power is measured, against noise in the reported energy."""
KEPT = 256


class _Begun(NamedTuple):
    charger: Point2D
    remaining_j: float
    stamp_ns: int


class ChargePower:
    """Learns the power of each charger; the latest measurement counts."""

    def __init__(self) -> None:
        self._power_w: dict[Point2D, float] = {}
        self._begun: dict[str, _Begun] = {}

    def of(self, charger: Point2D) -> float:
        """Power into the battery in watts, above 0."""
        known = self._known(charger)
        return USUAL_W if known is None else self._power_w[known]

    def note(self, robot: str, charger: Point2D, battery: BatteryState, now_ns: int) -> None:
        """Record a battery state of a robot that is charged at a charger."""
        begun = self._begun.get(robot)
        if begun is None or not is_same_charger(begun.charger, charger):
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)
        elif now_ns - begun.stamp_ns >= WINDOW_NS:
            power_w = (battery.remaining_j - begun.remaining_j) / to_seconds(now_ns - begun.stamp_ns)
            known = self._known(charger)
            self._power_w[charger if known is None else known] = max(LEAST_W, power_w)
            while len(self._power_w) > KEPT:
                del self._power_w[next(iter(self._power_w))]
            self._begun[robot] = _Begun(charger, battery.remaining_j, now_ns)

    def left(self, robot: str) -> None:
        """Record that a robot is no longer charged."""
        self._begun.pop(robot, None)

    def _known(self, charger: Point2D) -> Point2D | None:
        return next((place for place in self._power_w if is_same_charger(place, charger)), None)


DETOUR = 1.5
"""Assumed ratio of path length to straight line where no plan has the length (chosen; robots assume the same)."""
ROUTE_FACTOR = 2.0
"""A robot leaves its charger for tasks that wait for it when it has this many times what they take, beyond its reserve
(chosen: enough for the plan that is made then, and for a detour)."""
STILL_M = 1.0
"""While a robot has moved less than this, the path lengths of the last plan hold for it."""


class ChargeWatch:
    """Finds the robots that compete for chargers.

    Args:
        planning: knows the chargers, and which robots have tasks.
        book: of the tasks.
        roster: the robots of the team.

    """

    def __init__(self, planning: Planning, book: TaskBook, roster: Roster) -> None:
        self.power = ChargePower()
        self.cut_short: set[str] = set()
        """Robots whose last turn was cut short and which have not done a task since."""
        self._planning = planning
        self._book = book
        self._roster = roster

    def seekers(self, limits: Mapping[str, float], paused: set[str], now_ns: int) -> dict[str, Seeker]:
        """Return them by name.

        Args:
            limits: for each robot without a task, the state of charge below which it should charge.
            paused: robots that must not be asked to charge now.
            now_ns: the time.

        """
        found = {}
        for name in sorted(self._roster.robots):
            robot, at = self._roster.robots[name], self._book.of_robot(name)
            if at is not None and not at.own and at.task.kind != RECHARGE:
                self.cut_short.discard(name)
            limit = limits.get(name, 0.0)
            seeker = self.seeker(robot, at, limit, name in paused, now_ns) if robot.is_up(now_ns) else None
            if seeker is None or not seeker.is_there:
                self.power.left(name)
            if seeker is not None:
                found[name] = seeker
        return found

    def seeker(self, robot: Robot, at: TaskRecord | None, below: float, is_paused: bool, now_ns: int) -> Seeker | None:
        """A robot's entry for the schedule; None if it neither charges nor should."""
        planning, state, name = self._planning, robot.state, robot.name
        chargers = planning.chargers.of.get(name, ())
        if state is None or state.pose is None or state.battery is None or state.halted:
            return None
        here, battery = Point2D(state.pose.x_m, state.pose.y_m), state.battery
        bound_for = _bound_for(robot, at, here, chargers)
        if bound_for is None and (battery.soc >= below or not chargers or is_paused):
            return None
        if bound_for is None and (planning.why_out(robot, now_ns) or planning.has_route(name)):
            return None
        is_there = bound_for is not None and (battery.charging or is_same_charger(here, bound_for))
        if battery.charging and bound_for is not None:
            self.power.note(name, bound_for, battery, now_ns)
        to_soc = None
        if at is None and bound_for is not None and (is_paused or not is_there):
            to_soc = TO_SOC  # on its own initiative: the robot decides the level
        elif at is not None and not at.own and at.task.kind == RECHARGE:
            to_soc = parameters_of(at.task, Recharge).until_soc  # a submitted task
        return Seeker(
            name=name,
            soc=battery.soc,
            capacity_j=battery.remaining_j / max(battery.soc, SOC_LEAST),
            ways=self._ways(robot, here, chargers, is_bound=bound_for is not None),
            bound_for=bound_for,
            is_there=is_there,
            to_soc=to_soc,
            is_whole=name in self.cut_short,
            needs_soc=self._needs_soc(robot) if is_there else None,
        )

    def _needs_soc(self, robot: Robot) -> float | None:
        """Level at which a robot has enough for the tasks that wait for its charge; None if none do.

        It is no lower than the level below which an idle robot is sent to charge: it would have to come back at once.
        """
        takes_j, state = self._planning.takes_j(robot.name), robot.state
        if takes_j is None or state is None or state.battery is None or state.energy is None:
            return None
        battery, policy = state.battery, self._planning.policy
        capacity_j = battery.remaining_j / max(battery.soc, SOC_LEAST)
        missing_j = ROUTE_FACTOR * takes_j + policy.reserve_share * capacity_j - state.energy.usable_j
        if capacity_j <= 0.0:
            return None
        return max(policy.charge_below, battery.soc + missing_j / (CHARGED_SHARE * capacity_j))

    def _ways(self, robot: Robot, here: Point2D, chargers: tuple[Charger, ...], *, is_bound: bool) -> tuple[Way, ...]:
        """Paths to the chargers that it reaches with its reserve; to all if it is bound for one already."""
        assert robot.state is not None
        model, battery, policy = robot.state.energy, robot.state.battery, self._planning.policy
        profile = profile_of(model, policy.time_margin)
        known = self._planning.ways_to_chargers(robot.name)
        is_still = known is not None and _away_m(known.start, here) < STILL_M
        known_m = dict(known.ways_m) if known is not None and is_still else {}
        ways_m = [(known_m.get(one.place, DETOUR * _away_m(here, one.place)), one.place) for one in chargers]
        there = [(way_m, place) for way_m, place in ways_m if math.isfinite(way_m)]
        safe = there
        if model is not None and battery is not None and not is_bound:
            bound_j = model.usable_j - policy.reserve_share * battery.remaining_j / max(battery.soc, SOC_LEAST)
            safe = [one for one in there if estimate(model, Work(path_m=one[0])).high_j(policy.confidence) <= bound_j]
        # A robot that reaches none with its reserve goes to the nearest.
        nearest_one = sorted(there, key=lambda way: (way[0], way[1].x_m, way[1].y_m))[:1]
        return tuple(Way(place, way_m * profile.s_per_m) for way_m, place in safe or nearest_one)


def _bound_for(robot: Robot, at: TaskRecord | None, here: Point2D, chargers: tuple[Charger, ...]) -> Point2D | None:
    """The charger that a robot stands at or drives to; None if there is none."""
    if not is_charging(robot, at):
        return None
    charges = robot.state is not None and robot.state.battery is not None and robot.state.battery.charging
    near = nearest(here, chargers) if charges or at is None else None
    return at.task.place if near is None and at is not None else near


def _away_m(one: Point2D, other: Point2D) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
