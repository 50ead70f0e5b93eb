"""Motes as members of the team: a mote gets a task that it can do by itself if that costs the network less lifetime.

A `Sense` for a place that a mote is at is done by the mote's next reading. A `Monitor` with a quantity is done by its
readings for the task's duration, at an interval that `mote/M/duty` requests. Every robot that receives the mote relays
both directions. The task goes from queued to running at `mote:M`, and from there to done, or back to queued if no
reading comes in time. That mote is then skipped for a while, and the next in line, which may be a robot, is asked.
"""

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from robrain.algorithms.motes.mote_energy import (
    BITS_PER_S,
    CAPACITY_J,
    CELL_V,
    FLAT_V,
    FRESH_V,
    LISTEN_A,
    LOG_A,
    LOG_S,
    PACKET_BITS,
    SEND_A,
    SENSE_A,
    SENSE_S,
)
from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.team.roster import Roster
from robrain.protocol.border.border import Received
from robrain.protocol.border.reading_sieve import measured_at_ns
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteDuty, MoteReading
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskRecord
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import MONITOR, SENSE, Monitor, Sense
from robrain.protocol.model.tasks.task import MEMBER_PREFIX, BadParameters, TaskState, parameters_of
from robrain.protocol.reasons import DeadlinePassed, PlainReason, RobotOut, RobotReason, lacks_plugins, plain

LISTEN_S = 0.2
"""After a reading, for messages of a robot."""
LEAST_LEFT_J = 1e-3


def reading_j() -> float:
    """Energy of one reading for the motes: to sense, store and send it, and to listen for an answer.

    >>> round(1e3 * reading_j(), 2)
    8.77
    """
    send_j = SEND_A * CELL_V * PACKET_BITS / BITS_PER_S
    own_j = CELL_V * (SENSE_A * SENSE_S + LOG_A * LOG_S + LISTEN_A * LISTEN_S)
    return own_j + send_j


def mote_remaining_j(voltage_v: float) -> float:
    """Energy left in a mote's cells, by their voltage."""
    share = (voltage_v - FLAT_V) / (FRESH_V - FLAT_V)
    return max(LEAST_LEFT_J, min(1.0, share) * CAPACITY_J)


def mote_share(readings: int, voltage_v: float) -> float:
    """Share of a mote's energy for this number of readings; above 1 if it does not hold as much."""
    return readings * reading_j() / mote_remaining_j(voltage_v)


def robot_cost(state: RobotState, place: Point2D, stay_s: float) -> tuple[float, float | None]:
    """Least cost for a robot to go straight to a place and stay there.

    Returns:
        The share of its energy, and the energy in joules. Infinite and None if the robot reports no energy or pose:
        then a mote that can do the task is asked first.

    """
    if state.pose is None or state.energy is None:
        return math.inf, None
    energy_j = estimate(state.energy, Work(path_m=state.pose.distance_m(place), wait_s=stay_s)).mean_j
    return energy_j / max(state.energy.usable_j, LEAST_LEFT_J), round(energy_j, 1)


CHECK_NS = to_ns(0.25)
"""Period of checks whether a mote is late, when nothing has happened."""
NEAR_M = 1.5
"""A mote senses at its own place: at this distance its reading still counts for a place (chosen)."""
JUDGED = 8
"""Number of motes, the nearest, that are compared for a task."""
OWN_STAY_S = 1.0
"""Time of a robot's own board for a measurement."""
PATIENCE_PERIODS = 3.0
KEPT_PUBLISHERS = 64
BY = "coordinator"


MOTES_MAX = 4096
PERIODS = 3.0
"""A mote that has been silent for this number of its periods, and for `SILENT_S`, is out of reach (chosen)."""
SILENT_S = 5.0
USUAL_PERIOD_S = 4.0
"""Of a mote that does not report how often it senses."""


class KnownMote:
    """One mote."""

    def __init__(self, reading: MoteReading, now_ns: int) -> None:
        self.name = reading.mote
        self.latest = reading
        self.received_ns = now_ns

    @property
    def place(self) -> Point2D | None:
        """Where it is, arena frame."""
        return self.latest.place

    @property
    def period_s(self) -> float:
        """How often it senses and speaks."""
        return self.latest.period_s or USUAL_PERIOD_S

    def record(self, reading: MoteReading, now_ns: int) -> None:
        """A message arrived; a stored reading does not show its present state."""
        if measured_at_ns(reading) >= measured_at_ns(self.latest):
            self.latest, self.received_ns = reading, now_ns

    def out_of_reach_reason(self, roster: Roster, now_ns: int) -> RobotReason | None:
        """Why its messages cannot be relied on; None if they can."""
        silent_s = to_seconds(now_ns - self.received_ns)
        if silent_s > max(SILENT_S, PERIODS * self.period_s):
            return plain("mote_silent", f"was last heard {silent_s:.0f} s ago", silent_s=round(silent_s, 3))
        via = roster.robots.get(self.latest.via)
        # A carrier that is no robot is a gateway: its readings are its sign of life.
        out = via.down_reason(now_ns) if via is not None else None
        if via is None or out is None:
            return None
        text = f"{via.name}, which heard it, is not there: {out}"
        return plain("carrier_out", text, robot=via.name, because=out.code)


class MoteTable:
    """All known motes, up to a maximum number."""

    def __init__(self) -> None:
        self.motes: dict[str, KnownMote] = {}

    def quantities(self) -> dict[str, str]:
        """Last measured quantity of each mote, by its name."""
        return {name: mote.latest.quantity for name, mote in self.motes.items()}

    def record(self, reading: MoteReading, now_ns: int) -> None:
        """A robot or gateway has delivered a reading."""
        mote = self.motes.get(reading.mote)
        if mote is not None:
            mote.record(reading, now_ns)
        elif len(self.motes) < MOTES_MAX:
            self.motes[reading.mote] = KnownMote(reading, now_ns)

    def near(self, place: Point2D, most: int) -> list[KnownMote]:
        """The motes nearest to a place, nearest first; those that do not know where they are are not among them."""
        placed = [(place.distance_m(mote.place), mote.name) for mote in self.motes.values() if mote.place is not None]
        return [self.motes[name] for _, name in sorted(placed)[:most]]


class MoteTask:
    """A task that a mote is at."""

    def __init__(self, wanted: Sense | Monitor, mote: KnownMote, now_ns: int) -> None:
        self.wanted = wanted
        self.mote = mote
        self.began_ns = now_ns
        self.usual_s = mote.period_s
        """Its period before."""
        self.values: list[float] = []
        self.last_ns = now_ns
        """When it last brought something in."""
        self.interval_s = self.usual_s
        self.until_ns = now_ns
        if isinstance(wanted, Monitor):
            self.interval_s = min(self.usual_s, wanted.interval_s)
            self.until_ns = now_ns + to_ns(wanted.duration_s)
        self.patience_s = max(PATIENCE_PERIODS * self.usual_s, getattr(wanted, "timeout_s", 0.0))

    def record(self, reading: MoteReading, now_ns: int) -> None:
        """A reading of the mote has arrived."""
        quantity = self.wanted.quantity
        if measured_at_ns(reading) >= self.began_ns and reading.quantity == quantity:
            self.values.append(reading.value)
            self.last_ns = now_ns

    @property
    def result(self) -> dict[str, Any]:
        """Result of the task."""
        common: dict[str, Any] = {
            "mote": self.mote.name,
            "quantity": self.wanted.quantity,
            "energy_j": round(len(self.values) * reading_j(), 4),
        }
        if isinstance(self.wanted, Sense):
            return {"value": self.values[0], **common}
        return {"rounds": len(self.values), "least": min(self.values), "greatest": max(self.values), **common}


class MoteMembers(CoordinatorPart):
    """Gives motes the tasks that they can do.

    Args:
        core: the team.

    """

    inbox_max = 8192

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.table = MoteTable()
        self._book, self._roster = core.tasks, core.roster
        self._eligibility = core.lifecycle.eligibility
        self._has_received = False
        self._check_ns = 0
        self._seen_version = -1
        self._tasks: dict[str, MoteTask] = {}
        self._duties: dict[str, Publisher] = {}
        self.subscribe(MOTE_READING)

    # -- a step ---------------------------------------------------------------------------------------------

    def handle(self, received: Received, now_ns: int) -> None:
        """Remember a reading, for its mote and its task."""
        reading: MoteReading = received.message
        self._has_received = True
        self.table.record(reading, now_ns)
        for mote_task in self._tasks.values():
            if mote_task.mote.name == reading.mote:
                mote_task.record(reading, now_ns)

    def decide(self, now_ns: int) -> None:
        """End tasks that are done or hopeless, and give out new ones."""
        if not self._has_received and now_ns < self._check_ns and self._seen_version == self._book.version:
            return
        self._check_ns, self._has_received = now_ns + CHECK_NS, False
        with self.core.lifecycle.as_far_as_written(now_ns):
            for record in self._book.open:
                if record.robot.startswith(MEMBER_PREFIX) and self._follow(record, now_ns):
                    self.core.assign_soon()
            for task_id in [task_id for task_id in self._tasks if not self._is_at_it(task_id)]:
                self._forget(task_id)  # done, or called off
            for record in self._book.open:
                if record.state is TaskState.QUEUED:
                    self._give_out(record, now_ns)
        self._seen_version = self._book.version

    def mote_quantities(self) -> Mapping[str, str]:
        """All known motes, each with the quantity that it senses."""
        return self.table.quantities()

    def _follow(self, record: TaskRecord, now_ns: int) -> bool:
        """Check on a task that a mote has; returns whether others may do it now."""
        mote_task = self._tasks.get(record.task.id)
        if mote_task is None:  # of a coordinator before this one
            unknown = plain("mote_unknown", "the coordinator started again, and no mote is at it")
            self._book.give_back(record.task.id, unknown)
            return True
        if mote_task.values and now_ns >= mote_task.until_ns:
            self._book.move(record.task.id, TaskState.DONE, result=mote_task.result)
            return False
        deadline_ns = record.task.deadline_ns
        if deadline_ns is not None and now_ns > deadline_ns:
            self._book.move(record.task.id, TaskState.FAILED, DeadlinePassed())
            return False
        silent_s = to_seconds(now_ns - mote_task.last_ns)
        if silent_s <= mote_task.patience_s:
            return False
        reason = plain("told_nothing", f"told nothing in {silent_s:.0f} s", silent_s=round(silent_s, 3))
        self.core.lifecycle.backoff.record(record.task.id, record.robot, reason, now_ns)
        self._book.give_back(record.task.id, RobotOut(mote_task.mote.name, reason))
        return True

    def _is_at_it(self, task_id: str) -> bool:
        record = self._book.find(task_id)
        return record is not None and not record.state.ended and record.robot.startswith(MEMBER_PREFIX)

    # -- deciding -------------------------------------------------------------------------------------------

    def _give_out(self, record: TaskRecord, now_ns: int) -> None:
        wanted = wanted_of_motes(record)
        if wanted is None or self._eligibility.wait_reason(record, now_ns) is not None:
            return
        _, mote = self.judge(record, now_ns)
        if mote is None:
            return
        self._book.offered(record.task.id, f"{MEMBER_PREFIX}{mote.name}")
        self._book.move(record.task.id, TaskState.RUNNING)
        mote_task = self._tasks[record.task.id] = MoteTask(wanted, mote, now_ns)
        if mote_task.interval_s < mote_task.usual_s:
            self._ask_duty(mote.name, mote_task.interval_s)

    def judge(self, record: TaskRecord, now_ns: int) -> tuple[list[RobotVerdict], KnownMote | None]:
        """How each mote and robot stands to a task, and the mote that does it.

        It is None if no mote can, or if a robot costs the network less. The reasons have the share of its energy that
        the task would take each: see `motes_energy`.
        """
        wanted = wanted_of_motes(record)
        if wanted is None:
            return [], None
        motes = {mote.name: self._refusal(record, wanted, mote, now_ns) for mote in self._candidates(record, wanted)}
        shares = {
            name: mote_share(_readings(wanted, self.table.motes[name]), self.table.motes[name].latest.voltage_v)
            for name, reason in motes.items()
            if reason is None
        }
        best = min(shares, key=lambda name: (shares[name], name), default=None)
        robots = self._robots(record, wanted, now_ns)
        cheapest = min(robots, key=lambda name: (robots[name][0], name), default=None)
        is_mote = best is not None and (cheapest is None or shares[best] <= robots[cheapest][0])
        winner = best if is_mote else cheapest
        least = shares[best] if is_mote and best is not None else robots[cheapest][0] if cheapest is not None else 0.0
        judged = []
        for name, reason in sorted(motes.items(), key=lambda one: one[0]):
            energy_j = None if reason is not None else _readings(wanted, self.table.motes[name]) * reading_j()
            if reason is None and winner is not None and name != winner:
                reason = _dearer(shares[name], winner, least)
            judged.append(RobotVerdict.judged(name, reason, chosen=name == winner, energy_j=energy_j))
        for name, (share, cost_j) in sorted(robots.items()):
            dearer = None if winner is None or name == winner else _dearer(share, winner, least)
            judged.append(RobotVerdict.judged(name, dearer, energy_j=cost_j))
        return judged, self.table.motes[best] if is_mote and best is not None else None

    def verdicts(self, record: TaskRecord, now_ns: int) -> list[RobotVerdict]:
        """Verdicts of motes on a task, and those of robots too if a mote is to do it; none for tasks not for motes."""
        judged, mote = self.judge(record, now_ns)
        if mote is not None:
            return judged
        return [msgspec.structs.replace(one, chosen=False) for one in judged if one.robot in self.table.motes]

    def _candidates(self, record: TaskRecord, wanted: Sense | Monitor) -> list[KnownMote]:
        named = getattr(wanted, "mote", "")
        if named:
            return [self.table.motes[named]] if named in self.table.motes else []
        return self.table.near(record.task.place, JUDGED)

    def _refusal(self, record: TaskRecord, wanted: Sense | Monitor, mote: KnownMote, now_ns: int) -> RobotReason | None:
        task = record.task
        if task.needs:
            return lacks_plugins(task.needs)
        if (barred := self._eligibility.barred(task, f"{MEMBER_PREFIX}{mote.name}")) is not None:
            return barred
        away_m = 0.0 if mote.place is None else task.place.distance_m(mote.place)
        if away_m > NEAR_M and not getattr(wanted, "mote", ""):
            return plain("far_from_place", f"is {away_m:.1f} m from the place", away_m=round(away_m, 3))
        if mote.latest.quantity != wanted.quantity:
            text = f"senses {mote.latest.quantity}, not {wanted.quantity}"
            return plain("senses_other", text, quantity=mote.latest.quantity, wanted=wanted.quantity)
        if isinstance(wanted, Sense) and mote.period_s > wanted.timeout_s:
            text = f"speaks each {mote.period_s:g} s, and {wanted.timeout_s:g} s is all that is waited"
            return plain("speaks_seldom", text, period_s=mote.period_s, timeout_s=wanted.timeout_s)
        if (out := mote.out_of_reach_reason(self._roster, now_ns)) is not None:
            return out
        if mote_share(_readings(wanted, mote), mote.latest.voltage_v) >= 1.0:
            return plain("battery_too_small", "its battery does not last for it")
        return self.core.lifecycle.backoff.pause_reason(task.id, f"{MEMBER_PREFIX}{mote.name}", now_ns)

    def _robots(
        self, record: TaskRecord, wanted: Sense | Monitor, now_ns: int
    ) -> dict[str, tuple[float, float | None]]:
        """The costs of all robots that may do a task, by name."""
        stay_s = wanted.duration_s if isinstance(wanted, Monitor) else OWN_STAY_S
        return {
            robot.name: robot_cost(robot.state, record.task.place, stay_s)
            for robot in self._roster.up(now_ns)
            if robot.state is not None and self._eligibility.refusal(record, robot, now_ns) is None
        }

    # -- duty -----------------------------------------------------------------------------------------------

    def _ask_duty(self, mote: str, period_s: float) -> None:
        publisher = self._duties.pop(mote, None) or self.core.wire.publisher(MOTE_DUTY, mote=mote)
        self._duties[mote] = publisher
        publisher.put(MoteDuty(mote=mote, period_s=period_s, by=BY))
        if len(self._duties) > KEPT_PUBLISHERS:
            self._duties.pop(next(iter(self._duties))).close()

    def _forget(self, task_id: str) -> None:
        mote_task = self._tasks.pop(task_id)
        others = [other for other in self._tasks.values() if other.mote is mote_task.mote]
        if mote_task.interval_s < mote_task.usual_s and not others:
            self._ask_duty(mote_task.mote.name, mote_task.usual_s)


def wanted_of_motes(record: TaskRecord) -> Sense | Monitor | None:
    """The task's request, if a mote may do it; else None."""
    task = record.task
    try:
        if task.kind == SENSE:
            return parameters_of(task, Sense)
        if task.kind == MONITOR and (wanted := parameters_of(task, Monitor)).quantity:
            return wanted
    except BadParameters:  # of a task from before they were checked; its robot refuses it
        pass
    return None


def _readings(wanted: Sense | Monitor, mote: KnownMote) -> int:
    if not isinstance(wanted, Monitor):
        return 1
    return max(1, round(wanted.duration_s / min(wanted.interval_s, mote.period_s)))


def _dearer(share: float, cheapest: str, least_share: float) -> PlainReason:
    """The task takes a greater share of its energy than of another's.

    Args:
        share: share of its remaining energy that the task takes.
        cheapest: the robot or mote that takes the smallest share.
        least_share: that share.

    """
    text = f"would take {100 * share:.2g} % of its energy; {cheapest} takes {100 * least_share:.2g} % of its own"
    return plain("dearer", text, share=share, robot=cheapest, least_share=least_share)
