"""Keeps a field of motes alive: makes tasks to collect, stand in and relay, as a person would, and puts motes on duty.

The tasks are planned in the same objective as all others. Their record has the requester and the reason.
"""

import math
from collections import Counter

from msgspec import UNSET
from msgspec.structs import replace

from robrain.algorithms.motes.collect_tour import stops_for, visit_weight
from robrain.algorithms.motes.coverage import CellTrend, CoverageMap, duty_set
from robrain.algorithms.motes.mote_energy import FLAT_V, FRESH_V
from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.motes.mote_members import MOTES_MAX, PERIODS, SILENT_S, USUAL_PERIOD_S
from robrain.coordinator.planning.policy import MoteFieldPolicy, PlanningPolicy
from robrain.protocol.border.border import Received
from robrain.protocol.border.reading_sieve import ReadingSieve, measured_at_ns
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.motes.mote_messages import (
    MOTE_DUTY,
    MOTE_READING,
    ForwarderCount,
    GatewayCount,
    MoteDuty,
    MoteFieldState,
    MoteReading,
)
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import COLLECT, RELAY, REPLACE, Collect, Relay, Replace, TaskParameters
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import TaskReason, plain
from robrain.protocol.tinyos.payloads import PERIOD_MAX_S
from robrain.protocol.wire.endpoint import Endpoint

BY = "mote field"
AGAIN_NS = to_ns(60.0)
"""A mote that does not obey is asked again after this time (chosen)."""
OF_AGE = 0.4
"""A resting mote speaks at least as often as this share of the age at which it would be collected (chosen)."""
PERIOD_STEP_S = 0.1
"""Motes report their period in such steps."""


FORWARDERS_REPORTED = 16
GATEWAYS_MAX = 256


class ReadingPaths:
    """Counts the routes of readings."""

    def __init__(self) -> None:
        self.forwarded = 0
        """Readings that have come over other motes."""
        self._hops = 0
        self._first: Counter[str] = Counter()
        self._gateways: dict[str, MoteReading] = {}
        self._by_gateway: Counter[str] = Counter()

    def record(self, reading: MoteReading, *, is_new: bool) -> None:
        """Record a reading; `is_new` if it has not come before."""
        if reading.waiting is not UNSET and (reading.via in self._gateways or len(self._gateways) < GATEWAYS_MAX):
            self._gateways[reading.via] = reading
            self._by_gateway[reading.via] += is_new
        if reading.hops and reading.forwarder and is_new:
            self.forwarded += 1
            self._hops += reading.hops
            if reading.forwarder in self._first or len(self._first) < MOTES_MAX:
                self._first[reading.forwarder] += 1

    @property
    def mean_hops(self) -> float:
        """Mean number of motes that have passed such a reading on; 0 if there is none."""
        return round(self._hops / self.forwarded, 3) if self.forwarded else 0.0

    def forwarders(self) -> list[ForwarderCount]:
        """Motes that were most often the first to pass a reading on, most readings first."""
        ranked = sorted(self._first.items(), key=lambda one: (-one[1], one[0]))
        return [ForwarderCount(mote=mote, readings=readings) for mote, readings in ranked[:FORWARDERS_REPORTED]]

    def gateways(self) -> list[GatewayCount]:
        """The gateways that have sent readings, by name."""
        return [
            GatewayCount(
                name=name,
                readings=self._by_gateway[name],
                waiting=latest.waiting or 0,
                dropped=latest.dropped or 0,
                last_seen_ns=latest.stamp_ns,
            )
            for name, latest in sorted(self._gateways.items())
        ]


SEQUENCES = 65_536
NEARLY_FLAT_V = 0.02
"""A silent mote whose last voltage was within this of flat is dead (chosen)."""
POINTS_A_SIDE = 24
LEAST_SHARE = 0.001


class MoteLife:
    """One mote."""

    def __init__(self, reading: MoteReading) -> None:
        self.name = reading.mote
        self.latest = reading
        self.usual_period_s = reading.period_s or USUAL_PERIOD_S
        """As at its first reading."""
        self.arrived = 0
        self.is_hopeless = False
        """Whether robots failed to collect there since its last reading."""
        self._first_ns = measured_at_ns(reading)
        self._newest_ns = self._first_ns
        self.spoke_ns = self._first_ns
        """When the mote itself measured the newest reading that has arrived."""
        self._numbers = 0
        """Readings from the first that was received to the newest, without that."""
        self._trend = CellTrend()

    def record(self, reading: MoteReading, *, is_new: bool) -> None:
        """A reading has come. A reading measured by a robot in its place has no number, and gives no cell voltage."""
        measured_ns = measured_at_ns(reading)
        self.arrived += is_new
        if reading.sequence is None:
            self._newest_ns = max(self._newest_ns, measured_ns)
            return
        is_latest = reading.sequence == self.latest.sequence  # sent once more, with a new period perhaps
        if measured_ns < self.spoke_ns and not is_latest:
            return
        if self.latest.sequence is not None:
            self._numbers += (reading.sequence - self.latest.sequence) % SEQUENCES
        self.latest, self.spoke_ns = reading, max(self.spoke_ns, measured_ns)
        self._newest_ns = max(self._newest_ns, measured_ns)
        self.is_hopeless = False
        self._trend.add(to_seconds(measured_ns), reading.voltage_v)

    @property
    def place(self) -> Point2D | None:
        """Where it is, arena frame."""
        return self.latest.place

    @property
    def period_s(self) -> float:
        """How often it senses now."""
        return self.latest.period_s or self.usual_period_s

    @property
    def left_share(self) -> float:
        """Share of its cells' energy that is left, by their voltage."""
        share = (self.latest.voltage_v - FLAT_V) / (FRESH_V - FLAT_V)
        return min(1.0, max(LEAST_SHARE, share))

    def age_s(self, now_ns: int) -> float:
        """Age of its newest reading, or of the newest that another has taken in its place."""
        return to_seconds(max(0, now_ns - self._newest_ns))

    def silent_s(self, now_ns: int) -> float:
        """Age of the newest reading that it has taken itself."""
        return to_seconds(max(0, now_ns - self.spoke_ns))

    def is_overdue(self, now_ns: int) -> bool:
        """Whether it has been silent for longer than a reachable mote."""
        return self.silent_s(now_ns) > max(SILENT_S, PERIODS * self.period_s)

    def is_reported(self, now_ns: int) -> bool:
        """Whether it, or a robot in its place, reports about the floor around it at the expected rate."""
        return self.age_s(now_ns) <= max(SILENT_S, PERIODS * self.period_s)

    def remaining_s(self, now_ns: int) -> float:
        """Remaining time of its cells if they drain as before; infinite if it is unknown."""
        empty_s = self._trend.empty_s()
        return math.inf if empty_s is None else empty_s - to_seconds(now_ns)

    def is_dead(self, now_ns: int) -> bool:
        """Whether its cells are empty, by its reports."""
        if not self.is_overdue(now_ns):
            return False
        return self.is_hopeless or self.latest.voltage_v <= FLAT_V + NEARLY_FLAT_V or self.remaining_s(now_ns) <= 0

    def due(self, now_ns: int) -> float:
        """Readings that it measured, or would have measured, since its first reading, that one included."""
        return 1.0 + self._numbers + max(0.0, self.silent_s(now_ns) - self.period_s) / self.period_s


class FieldLedger:
    """All known motes."""

    def __init__(self, sensing_m: float) -> None:
        self.motes: dict[str, MoteLife] = {}
        self.paths = ReadingPaths()
        self._sieve = ReadingSieve()
        self._sensing_m = sensing_m
        self._placed: tuple[str, ...] = ()
        self._cover: CoverageMap | None = None

    def record(self, reading: MoteReading) -> None:
        """A reading has come, from a mote or from a robot in its place."""
        is_new = self._sieve.is_new(reading)
        mote = self.motes.get(reading.mote)
        if mote is None:
            if reading.sequence is None or len(self.motes) >= MOTES_MAX:
                return
            mote = self.motes[reading.mote] = MoteLife(reading)
        mote.record(reading, is_new=is_new)
        self.paths.record(reading, is_new=is_new)

    def placed(self) -> list[MoteLife]:
        """The motes that know where they are, by name."""
        return [mote for _, mote in sorted(self.motes.items()) if mote.place is not None]

    def cover(self) -> CoverageMap:
        """Coverage by each of `placed` of the floor between them, within the reach of any of them."""
        placed = self.placed()
        names = tuple(mote.name for mote in placed)
        if self._cover is None or names != self._placed:
            self._placed = names
            self._cover = _cover_of([mote.place for mote in placed if mote.place is not None], self._sensing_m)
        return self._cover

    def state(self, on_duty: set[str], now_ns: int) -> MoteFieldState | None:
        """State of the field; None before the first reading.

        Args:
            on_duty: names of the motes that are on duty.
            now_ns: the time.

        """
        if not self.motes:
            return None
        lives = list(self.motes.values())
        dead = sorted(mote.spoke_ns for mote in lives if mote.is_dead(now_ns))
        living = [mote for mote in lives if not mote.is_dead(now_ns)]
        ages_s = [mote.age_s(now_ns) for mote in living]
        reported = [index for index, mote in enumerate(self.placed()) if mote.is_reported(now_ns)]
        due = sum(mote.due(now_ns) for mote in lives)
        half = (len(lives) + 1) // 2
        return MoteFieldState(
            motes=len(lives),
            dead=len(dead),
            delivery_ratio=round(min(1.0, sum(mote.arrived for mote in lives) / due), 4),
            age_s=round(sum(ages_s) / len(ages_s), 3) if ages_s else 0.0,
            oldest_s=round(max(ages_s, default=0.0), 3),
            coverage=round(self.cover().share(reported), 4) if self.placed() else 0.0,
            on_duty=sum(mote.name in on_duty for mote in living),
            first_dead_ns=dead[0] if dead else None,
            half_dead_ns=dead[half - 1] if len(dead) >= half else None,
            last_dead_ns=dead[-1] if len(dead) == len(lives) else None,
            forwarded=self.paths.forwarded or UNSET,
            hops=self.paths.mean_hops or UNSET,
            forwarders=self.paths.forwarders() or UNSET,
            gateways=self.paths.gateways() or UNSET,
        )


def _cover_of(places: list[Point2D], sensing_m: float) -> CoverageMap:
    low_x_m, low_y_m = min(place.x_m for place in places), min(place.y_m for place in places)
    width_m, height_m = max(place.x_m for place in places) - low_x_m, max(place.y_m for place in places) - low_y_m
    steps = [(index + 0.5) / POINTS_A_SIDE for index in range(POINTS_A_SIDE)]
    points = [Point2D(low_x_m + x * width_m, low_y_m + y * height_m) for x in steps for y in steps]
    within = [point for point in points if any(place.distance_m(point) <= sensing_m for place in places)]
    return CoverageMap(places, within, sensing_m)


class FieldDuties:
    """Asks motes how often to sense, by turns.

    Args:
        wire: the coordinator's Zenoh endpoint.
        ledger: of the motes.

    """

    def __init__(self, wire: Endpoint, ledger: FieldLedger) -> None:
        self.on_duty: set[str] = set()
        """Names of the motes that are on duty."""
        self._wire = wire
        self._ledger = ledger
        self._asked: dict[str, tuple[float, int]] = {}
        """Period and time for which each mote was asked."""
        self._resting: set[str] = set()
        self._turn_ns = 0

    def step(self, policy: MoteFieldPolicy, now_ns: int) -> None:
        """Put motes on and off duty if it is time, and repeat orders that were not obeyed."""
        living = [mote for mote in self._ledger.motes.values() if not mote.is_dead(now_ns)]
        if policy.turns_s and living and now_ns >= self._turn_ns:
            self._turn_ns = now_ns + to_ns(policy.turns_s)
            self._resting = self._choose(now_ns)
        self.on_duty = {mote.name for mote in living} - self._resting
        for mote in living if policy.turns_s else ():
            wanted_s = _resting_s(policy, mote.usual_period_s) if mote.name in self._resting else mote.usual_period_s
            period_s, asked_ns = self._asked.get(mote.name, (mote.usual_period_s, 0))
            is_unheeded = abs(mote.period_s - wanted_s) > PERIOD_STEP_S and now_ns >= asked_ns + AGAIN_NS
            if wanted_s != period_s or is_unheeded:
                self._ask(mote.name, wanted_s, now_ns)

    def _choose(self, now_ns: int) -> set[str]:
        """Names of the motes that may rest: the floor is covered without them."""
        placed = self._ledger.placed()
        left = {number: mote.left_share for number, mote in enumerate(placed) if not mote.is_dead(now_ns)}
        chosen = duty_set(self._ledger.cover(), left) if left else []
        return {placed[number].name for number in left if number not in chosen}

    def _ask(self, mote: str, period_s: float, now_ns: int) -> None:
        self._asked[mote] = (period_s, now_ns)
        publisher = self._wire.publisher(MOTE_DUTY, mote=mote)
        publisher.put(MoteDuty(mote=mote, period_s=period_s, by=BY))
        publisher.close()


def _resting_s(policy: MoteFieldPolicy, usual_s: float) -> float:
    """Period off duty; so short that no robot is sent to a mote only because it rests."""
    longest_s = policy.collect_age_s * OF_AGE if policy.collect_age_s else PERIOD_MAX_S
    return max(usual_s, min(PERIOD_MAX_S, longest_s, policy.rest_factor * usual_s))


CHECK_NS = to_ns(1.0)
ALONG_SHARE = 0.6
"""Once a mote is due, those that have reached this share of the age are collected on the same tour (chosen)."""
FRESH_SHARE = 0.5
"""A queued task to collect is called off if the data have meanwhile come, and are younger than this share (chosen)."""
WEIGHTS = (0.2, 10.0)
"""Least and greatest priority of a task to collect."""
PERIODS_WAITED = 3.0
FRESH_AGAIN_NS = to_ns(30.0)
"""After a robot was at a mote, no other is sent there for this time (chosen)."""


class FieldKeeper(CoordinatorPart):
    """Makes tasks for the field, and reports on it.

    Args:
        core: the team.

    """

    inbox_max = 8192

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        policy = core.planning.policy.mote_field
        self.is_on = False
        self.ledger = FieldLedger(policy.sensing_m)
        self.state: MoteFieldState | None = None
        """State of the field; None while nothing is done for it."""
        self._wire, self._book = core.wire, core.tasks
        self._listens = False
        self._policy = MoteFieldPolicy()
        self._duties = FieldDuties(core.wire, self.ledger)
        self._check_ns = 0
        self._made: dict[str, tuple[str, str]] = {}
        """Kind and mote of each own task that has not ended."""
        self._ended_ns: dict[tuple[str, str], int] = {}
        """When the last own task of a kind for a mote ended."""
        self._open: set[tuple[str, str]] = set()
        """Kind and mote of all tasks that have not ended, of any requester."""
        self._set_policy(policy)

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Do this from now on; existing tasks continue."""
        self._set_policy(policy.mote_field)

    def _set_policy(self, policy: MoteFieldPolicy) -> None:
        if policy == self._policy:
            return
        self._policy = policy
        self.ledger = FieldLedger(policy.sensing_m)
        self._duties = FieldDuties(self._wire, self.ledger)
        self.is_on = policy.is_on
        self.state = None
        if self.is_on and not self._listens:
            self._listens = True
            self.subscribe(MOTE_READING)

    def handle(self, received: Received, now_ns: int) -> None:
        """Remember a reading."""
        self.ledger.record(received.message)

    def decide(self, now_ns: int) -> None:
        """Once a second, make and call off tasks."""
        if not self.is_on or now_ns < self._check_ns:
            return
        self._check_ns = now_ns + CHECK_NS
        before = len(self._made)
        with self.core.lifecycle.as_far_as_written(now_ns):
            self._follow(now_ns)
            before = len(self._made)
            self._collect(now_ns)
            self._replace_motes(now_ns)
            self._relay(now_ns)
        if len(self._made) > before:
            self.core.assign_soon()
        self._duties.step(self._policy, now_ns)
        self.state = self.ledger.state(self._duties.on_duty, now_ns)

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the state of the field."""
        return state if self.state is None else replace(state, mote_field=self.state)

    # -- following ------------------------------------------------------------------------------------------

    def _follow(self, now_ns: int) -> None:
        """Forget own tasks that have ended, and call off those that are no longer needed."""
        self._open.clear()
        for one in self._book.open:
            what = (one.task.kind, str(one.task.parameters.get("mote", "")))
            self._open.add(what)
            if one.by == BY and one.task.id not in self._made:  # of a coordinator before this one
                self._made[one.task.id] = what
        for task_id, (kind, name) in list(self._made.items()):
            record = self._book.find(task_id)
            mote = self.ledger.motes.get(name)
            if record is None or record.state.ended:
                self._end(task_id, record, mote, now_ns)
            elif kind == COLLECT and mote is not None and record.state is TaskState.QUEUED:
                age_s = mote.age_s(now_ns)
                if age_s < FRESH_SHARE * self._policy.collect_age_s:
                    text = f"{name} was heard without it, {age_s:.0f} s ago"
                    reason = plain("mote_heard", text, mote=name, age_s=round(age_s, 3))
                    self._book.move(task_id, TaskState.CANCELLED, reason)
                    del self._made[task_id]

    def _end(self, task_id: str, record: TaskRecord | None, mote: MoteLife | None, now_ns: int) -> None:
        kind, name = self._made.pop(task_id)
        self._ended_ns[kind, name] = now_ns
        was_tried = record is not None and record.state is TaskState.FAILED and record.attempts > 0
        if kind == COLLECT and mote is not None and record is not None and was_tried:
            mote.is_hopeless = mote.spoke_ns < record.submitted_ns

    def _has(self, kind: str, mote: str) -> bool:
        return (kind, mote) in self._open or (kind, mote) in self._made.values()

    def _count(self, kind: str) -> int:
        return sum(made == kind for made, _ in self._made.values())

    # -- making ---------------------------------------------------------------------------------------------

    def _collect(self, now_ns: int) -> None:
        wanted_s = self._policy.collect_age_s
        living = [mote for mote in self.ledger.placed() if not mote.is_dead(now_ns)] if wanted_s else []
        due = [mote for mote in living if mote.age_s(now_ns) >= wanted_s and self._may(COLLECT, mote, now_ns)]
        if not due:
            return
        for mote in living:
            age_s = mote.age_s(now_ns)
            if age_s < ALONG_SHARE * wanted_s or not self._may(COLLECT, mote, now_ns):
                continue
            weight = visit_weight(age_s, wanted_s, mote.remaining_s(now_ns))
            timeout_s = max(self._policy.collect_timeout_s, PERIODS_WAITED * mote.period_s)
            text = f"the newest reading of {mote.name} is {age_s:.0f} s old"
            reason = plain("data_old", text, mote=mote.name, age_s=round(age_s, 3))
            priority = round(min(WEIGHTS[1], max(WEIGHTS[0], weight)), 3)
            self._make(COLLECT, mote, Collect(mote=mote.name, timeout_s=timeout_s), reason, priority)

    def _replace_motes(self, now_ns: int) -> None:
        """Stand in where most of the floor would otherwise be covered by no mote."""
        placed = self.ledger.placed()
        ending = [mote.is_dead(now_ns) or mote.remaining_s(now_ns) < self._policy.replace_before_s for mote in placed]
        room = self._policy.replacements - self._count(REPLACE)
        if room <= 0 or not any(ending):
            return
        cover = self.ledger.cover()
        reported = cover.spots(
            [number for number, mote in enumerate(placed) if not ending[number] or self._has(REPLACE, mote.name)]
        )
        waiting = [number for number, mote in enumerate(placed) if ending[number] and not self._has(REPLACE, mote.name)]
        while waiting and room > 0:
            best = max(waiting, key=lambda number: ((cover.covered[number] & ~reported).bit_count(), -number))
            if not cover.covered[best] & ~reported:
                return
            waiting.remove(best)
            reported |= cover.covered[best]
            room -= 1
            mote = placed[best]
            wanted = Replace(mote=mote.name, duration_s=self._policy.replacement_s, period_s=mote.usual_period_s)
            remaining_s = max(0.0, mote.remaining_s(now_ns)) if not mote.is_dead(now_ns) else 0.0
            cells = f"the cells of {mote.name} {f'last for {remaining_s:.0f} s' if remaining_s else 'are empty'}"
            reason = plain("mote_ends", cells, mote=mote.name, remaining_s=round(remaining_s, 3))
            self._make(REPLACE, mote, wanted, reason)

    def _relay(self, now_ns: int) -> None:
        """Stand where most motes are within reach that no robot receives."""
        room = self._policy.relays - self._count(RELAY)
        if room <= 0:
            return
        placed = self.ledger.placed()
        places = [mote.place for mote in placed if mote.place is not None]
        served = [
            place for kind, name in self._made.values() if kind == RELAY and (place := self._place_of(name)) is not None
        ]
        silent = [
            number
            for number, mote in enumerate(placed)
            if mote.is_overdue(now_ns)
            and not mote.is_dead(now_ns)
            and all(places[number].distance_m(place) > self._policy.relay_reach_m for place in served)
            and self._may(RELAY, mote, now_ns)
        ]
        for stop in stops_for(places, silent, self._policy.relay_reach_m)[:room]:
            mote = next(placed[number] for number in stop.motes if places[number] == stop.place)
            wanted = Relay(mote=mote.name, duration_s=self._policy.relay_s)
            others = len(stop.motes) - 1
            text = f"nobody hears {mote.name}{f' and {others} others' if others else ''}"
            self._make(RELAY, mote, wanted, plain("mote_cut_off", text, mote=mote.name, others=others))

    def _place_of(self, name: str) -> Point2D | None:
        mote = self.ledger.motes.get(name)
        return None if mote is None else mote.place

    def _may(self, kind: str, mote: MoteLife, now_ns: int) -> bool:
        ended_ns = self._ended_ns.get((kind, mote.name))
        is_rested = ended_ns is None or now_ns >= ended_ns + FRESH_AGAIN_NS
        return is_rested and not self._has(kind, mote.name)

    def _make(
        self, kind: str, mote: MoteLife, wanted: TaskParameters, reason: TaskReason, priority: float = 1.0
    ) -> None:
        assert mote.place is not None
        task = Task(id=self.core.new_id(kind), kind=kind, place=mote.place, priority=priority, parameters=wanted.json)
        self._book.add(task, by=BY, reason=reason)
        self._made[task.id] = (kind, mote.name)
