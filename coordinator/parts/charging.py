"""Sends robots to charge, by tasks of the coordinator's own, following the schedule of the chargers.

It also predicts the state of charging robots after the charge, for the planner. It ends a charge early when there is
enough for the tasks that wait for it.
"""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.parts.charge_schedule import ChargerPath, ChargerSlot, ChargeSeeker, schedule_charges
from robrain.coordinator.planning.energy_budget import (
    CHARGED_SHARE,
    CHARGED_SOC,
    DETOUR,
    SOC_LEAST,
    capacity_j,
    profile_of,
)
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.snapshot import AfterCharge
from robrain.coordinator.planning.snapshot_builder import is_charging
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.chargers import Charger, is_same_charger
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.plan_messages import COORDINATOR_CHARGES, ChargeSchedule, PlannedCharge
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.reasons import OfferRefusal, PlainReason, WaitsForCharge, plain, sentence_of

FULL_ENOUGH = 0.9
"""Below this level, a robot that lacks only the energy to explore is sent to charge."""


ROUTE_FACTOR = 2.0
"""A robot leaves its charger for tasks that wait for it when it has this many times their energy, beyond its reserve
(chosen). That is enough for the plan that is made then, and for a detour."""
STILL_M = 1.0
"""While a robot has moved less than this, the path lengths of the last plan hold for it."""


class ChargeSeekers:
    """Finds the robots that compete for chargers.

    Args:
        planning: knows the chargers, and which robots have tasks.
        book: of the tasks.
        roster: the robots of the team.

    """

    def __init__(self, planning: Planning, book: TaskBook, roster: Roster) -> None:
        self.cut_short: set[str] = set()
        """Robots whose last turn was cut short and which have not done a task since."""
        self._planning = planning
        self._book = book
        self._roster = roster

    def seekers(self, limits: Mapping[str, float], paused: set[str], now_ns: int) -> dict[str, ChargeSeeker]:
        """Return them by name.

        Args:
            limits: for each robot without a task, the state of charge below which it should charge; infinite before
                a task that needs a charge.
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
                self._planning.chargers.power.stop(name)
            if seeker is not None:
                found[name] = seeker
        return found

    def seeker(
        self, robot: Robot, at: TaskRecord | None, below: float, is_paused: bool, now_ns: int
    ) -> ChargeSeeker | None:
        """A robot's entry for the schedule; None if it neither charges nor should."""
        planning, state, name = self._planning, robot.state, robot.name
        chargers = planning.chargers.of.get(name, ())
        if state is None or state.pose is None or state.battery is None or state.halted:
            return None
        here, battery = Point2D(state.pose.x_m, state.pose.y_m), state.battery
        bound_for = _bound_for(robot, at, here, chargers)
        if bound_for is None and (battery.soc >= below or not chargers or is_paused):
            return None
        is_needed = below < math.inf and planning.has_route(name)
        if bound_for is None and (planning.exclusion(robot, now_ns) or is_needed):
            return None
        is_there = bound_for is not None and (battery.charging or is_same_charger(here, bound_for))
        if battery.charging and bound_for is not None:
            planning.chargers.power.record(name, bound_for, battery, now_ns)
        to_soc = None
        if at is None and bound_for is not None and (is_paused or not is_there):
            to_soc = CHARGED_SOC  # on its own initiative: the robot decides the level
        elif at is not None and not at.own and at.task.kind == RECHARGE:
            to_soc = parameters_of(at.task, Recharge).until_soc  # a submitted task
        return ChargeSeeker(
            name=name,
            soc=battery.soc,
            capacity_j=capacity_j(battery),
            paths=self._paths(robot, here, chargers, is_bound=bound_for is not None),
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
        route_j, state = self._planning.route_energy_j(robot.name), robot.state
        if route_j is None or state is None or state.battery is None or state.energy is None:
            return None
        battery, policy = state.battery, self._planning.policy
        full_j = capacity_j(battery)
        missing_j = ROUTE_FACTOR * route_j + policy.reserve_share * full_j - state.energy.usable_j
        if full_j <= 0.0:
            return None
        return max(policy.charge_below, battery.soc + missing_j / (CHARGED_SHARE * full_j))

    def _paths(
        self, robot: Robot, here: Point2D, chargers: tuple[Charger, ...], *, is_bound: bool
    ) -> tuple[ChargerPath, ...]:
        """Paths to the chargers that it reaches with its reserve; to all if it is bound for one already."""
        assert robot.state is not None
        model, battery, policy = robot.state.energy, robot.state.battery, self._planning.policy
        profile = profile_of(model, policy.time_margin)
        known = self._planning.charger_distances_m(robot.name)
        is_still = known is not None and known.start.distance_m(here) < STILL_M
        known_m = dict(known.lengths_m) if known is not None and is_still else {}
        lengths_m = [(known_m.get(one.place, DETOUR * here.distance_m(one.place)), one.place) for one in chargers]
        there = [(path_m, place) for path_m, place in lengths_m if math.isfinite(path_m)]
        safe = there
        if model is not None and battery is not None and not is_bound:
            bound_j = model.usable_j - policy.reserve_share * battery.remaining_j / max(battery.soc, SOC_LEAST)
            safe = [one for one in there if estimate(model, Work(path_m=one[0])).high_j(policy.confidence) <= bound_j]
        # A robot that reaches none with its reserve goes to the nearest.
        nearest_one = sorted(there, key=lambda path: (path[0], path[1].x_m, path[1].y_m))[:1]
        return tuple(ChargerPath(place, path_m * profile.s_per_m) for path_m, place in safe or nearest_one)


def _bound_for(robot: Robot, at: TaskRecord | None, here: Point2D, chargers: tuple[Charger, ...]) -> Point2D | None:
    """The charger that a robot stands at or drives to; None if there is none."""
    if not is_charging(robot, at):
        return None
    charges = robot.state is not None and robot.state.battery is not None and robot.state.battery.charging
    near = _nearest(here, chargers) if charges or at is None else None
    return at.task.place if near is None and at is not None else near


def _nearest(place: Point2D, chargers: Sequence[Charger]) -> Point2D | None:
    order = sorted((place.distance_m(one.place), one.place.x_m, one.place.y_m) for one in chargers)
    return Point2D(*order[0][1:]) if order else None


MOVED_NS, MOVED_SHARE = to_ns(10.0), 0.1
"""The schedule is published again when the end of a charge has moved by more than both, or when another field has
changed (chosen). The share is of the time until then."""

MOVED_SOC = 0.1
"""The level that a task waits for is published again when it has moved by more (chosen)."""


def _planned(turn: ChargerSlot, one: ChargeSeeker, has_set_out: bool, now_ns: int) -> PlannedCharge:
    reason = None
    if turn.behind and not one.is_there:
        at, free_s = f"({turn.charger.x_m:.1f}, {turn.charger.y_m:.1f})", round(turn.free_s, 3)
        text = f"waits for the charger at {at}, free in {free_s:.0f} s: {turn.behind} has it before"
        reason = plain("waits_for_charger", text, free_s=free_s, behind=turn.behind)
    return PlannedCharge(
        robot=turn.robot,
        charger=turn.charger,
        set_out_ns=now_ns + (0 if has_set_out else to_ns(turn.set_out_s)),
        from_ns=now_ns + to_ns(turn.from_s),
        until_ns=now_ns + to_ns(turn.until_s),
        soc=round(one.soc, 3),
        to_soc=round(turn.to_soc, 3),
        behind=turn.behind,
        has_set_out=has_set_out,
        is_there=one.is_there,
        why=sentence_of(reason),
        reason=reason,
    )


def _is_same_schedule(published: tuple[PlannedCharge, ...], now: tuple[PlannedCharge, ...], now_ns: int) -> bool:
    """Whether the published schedule still holds, apart from the passing of time."""
    if [_FIXED(one) for one in published] != [_FIXED(one) for one in now]:
        return False
    return all(
        abs(one.until_ns - other.until_ns) <= max(MOVED_NS, MOVED_SHARE * (one.until_ns - now_ns))
        for one, other in zip(published, now, strict=True)
    )


_FIXED = attrgetter("robot", "charger", "behind", "has_set_out", "is_there")
"""Fields that change only when the schedule does."""
AGAIN_NS = to_ns(30.0)
"""Pause after a robot refused to charge, or failed at it (chosen)."""
EARLY_S = 5.0
"""A robot sets out this much early, because it may have to stop on its path (chosen)."""


class Charging(CoordinatorPart):
    """Decides which robots charge.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.waiting: Mapping[str, PlainReason | None] = {}
        """Robots that should charge and have not set out, with the reason if it is known."""
        self._planning, self._book, self._roster = core.planning, core.tasks, core.roster
        self._competing = ChargeSeekers(core.planning, core.tasks, core.roster)
        self._publisher = core.wire.publisher(COORDINATOR_CHARGES)
        self._published: tuple[PlannedCharge, ...] = ()
        self._not_before_ns: dict[str, int] = {}

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Send robots to charge, if plans are made."""
        if not self._planning.is_on:
            return
        pauses = self.core.lifecycle.backoff.robots
        free = [robot for robot in self.core.idle(robots) if not pauses.pause_reason(robot.name, now_ns)]
        for robot, task in self.choose(free, now_ns).items():
            self.core.offer_own(task, robot, now_ns)

    def task_ended(self, record: TaskRecord, robot: str, status: TaskStatus, now_ns: int) -> None:
        """A robot's charge may have ended."""
        if record.task.kind == RECHARGE:
            self._ended(record, robot, status.state, now_ns)

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot may have refused to charge."""
        if record.task.kind == RECHARGE:
            self._ended(record, robot, TaskState.FAILED, now_ns)

    def choose(self, idle: list[Robot], now_ns: int) -> dict[str, Task]:
        """Return the tasks to charge of the robots, of those without a task, that must be asked to charge now.

        Raises:
            JournalUnwritable: the end of a charge, or the reason why a task waits, could not be written; both are tried
                again.

        """
        planning = self._planning
        self._not_before_ns = {name: at for name, at in self._not_before_ns.items() if at > now_ns}
        if not any(planning.chargers.of.values()):
            self.waiting = {}
            planning.after_charge.clear()
            self._publish_schedule((), {}, set(), now_ns)
            return {}
        below, to_charge = planning.policy.charge_below, planning.to_charge()
        limits = {robot.name: FULL_ENOUGH if robot.name in planning.lack_range else below for robot in idle}
        limits |= dict.fromkeys(limits.keys() & to_charge, math.inf)
        seekers = self._competing.seekers(limits, set(self._not_before_ns), now_ns)
        turns = schedule_charges(seekers.values(), planning.chargers.power.of)
        charges = {turn.robot: self._charge(turn) for turn in turns if self._is_due(turn, seekers[turn.robot])}
        has_set_out = charges.keys() | {name for name, one in seekers.items() if one.bound_for is not None}
        planning.after_charge.clear()
        for turn in turns:
            if turn.robot in has_set_out:
                free_ns = now_ns + to_ns(turn.until_s)
                planning.after_charge[turn.robot] = AfterCharge(free_ns, turn.charger, turn.to_soc)
        self.waiting = self._publish_schedule(turns, seekers, has_set_out, now_ns)
        self._end(turns, seekers)
        self._publish_waiting(now_ns)
        return charges

    def _ended(self, record: TaskRecord, robot: str, state: TaskState, now_ns: int) -> None:
        """Handle the end, or the refusal, of a robot's charge."""
        self._planning.after_charge.pop(robot, None)
        if state is not TaskState.DONE:
            self._not_before_ns[robot] = now_ns + AGAIN_NS
        elif record.own and parameters_of(record.task, Recharge).until_soc < CHARGED_SOC:
            self._competing.cut_short.add(robot)
        else:
            self._competing.cut_short.discard(robot)

    def _is_due(self, turn: ChargerSlot, one: ChargeSeeker) -> bool:
        """Whether to order a charge: to set out when it is time, or, if it charges on its own initiative, to end."""
        is_due = one.bound_for is None and turn.set_out_s <= EARLY_S
        is_firm = one.bound_for is not None and one.to_soc is None and self._book.of_robot(turn.robot) is None
        return is_due or (is_firm and one.is_there and one.soc >= turn.to_soc < CHARGED_SOC)

    def _charge(self, turn: ChargerSlot) -> Task:
        known = self._planning.chargers.of.get(turn.robot, ())
        charger = next(one for one in known if is_same_charger(one.place, turn.charger))
        wanted = Recharge(yaw_rad=charger.yaw_rad, until_soc=round(turn.to_soc, 3))
        return Task(id=self.core.new_id(RECHARGE), kind=RECHARGE, place=charger.place, parameters=wanted.json)

    def _end(self, turns: tuple[ChargerSlot, ...], seekers: dict[str, ChargeSeeker]) -> None:
        """End the charges that have reached their level of the tasks that wait for them."""
        for turn in turns:
            at, one = self._book.of_robot(turn.robot), seekers[turn.robot]
            if at is None or not at.own or at.task.kind != RECHARGE or not one.is_there:
                continue
            if turn.to_soc < parameters_of(at.task, Recharge).until_soc and one.soc >= turn.to_soc:
                self._competing.cut_short.add(turn.robot)
                text = f"{turn.robot} has charged to {one.soc:.0%}, enough for the tasks that wait for it"
                reason = plain("charged_for_tasks", text, robot=turn.robot, soc=one.soc)
                self._book.move(at.task.id, TaskState.CANCELLED, reason)

    # -- publishing -----------------------------------------------------------------------------------------

    def _publish_schedule(
        self, turns: tuple[ChargerSlot, ...], seekers: dict[str, ChargeSeeker], has_set_out: set[str], now_ns: int
    ) -> dict[str, PlainReason | None]:
        """Publish the schedule if it has changed; returns why each robot that has not set out waits, if known."""
        charges = tuple(_planned(turn, seekers[turn.robot], turn.robot in has_set_out, now_ns) for turn in turns)
        self._planning.charges = charges
        if not _is_same_schedule(self._published, charges, now_ns):
            self._published = charges
            self._publisher.put(ChargeSchedule(charges=charges))
        return {one.robot: one.reason for one in charges if not one.has_set_out}

    def _publish_waiting(self, now_ns: int) -> None:
        """Publish for each queued task that it waits for its robot to charge, and when this ends."""
        for record in self._book.open:
            if record.own or record.task.paused or record.state is not TaskState.QUEUED:
                continue
            robot = self._planning.waits_for_charge(record.task.id)
            known = record.reason if isinstance(record.reason, WaitsForCharge) else None
            after = self._planning.after_charge.get(robot)
            if after is not None and (
                known is None or known.robot != robot or abs(known.to_soc - after.soc) > MOVED_SOC
            ):
                in_s = max(0.0, to_seconds(after.free_ns - now_ns))
                self._book.move(record.task.id, TaskState.QUEUED, WaitsForCharge(robot, after.soc, round(in_s, 3)))
            elif not robot and known is not None and record.task.id not in self._planning.left_out:
                self._book.move(record.task.id, TaskState.QUEUED)
