"""What is known of each mote over time: readings taken and arrived, ages, the end of its cells."""

import math
from collections import Counter

from msgspec import UNSET

from robrain.algorithms.motes.cell_trend import CellTrend
from robrain.algorithms.motes.coverage import CoverageMap
from robrain.algorithms.motes.mote_energy import FLAT_V, FRESH_V
from robrain.coordinator.motes.mote_registry import MOTES_MAX, PERIODS, SILENT_S, USUAL_PERIOD_S
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.border.reading_sieve import ReadingSieve, taken_at_ns
from robrain.protocol.wire.clock import to_seconds
from robrain.protocol.wire.messages.motes.mote_field_messages import ForwarderCount, GatewayCount, MoteFieldState
from robrain.protocol.wire.messages.motes.mote_messages import MoteReading

FORWARDERS_TOLD = 16
GATEWAYS_MAX = 256


class FieldWays:
    """Counts the ways of readings."""

    def __init__(self) -> None:
        self.forwarded = 0
        """Readings that have come over other motes."""
        self._hops = 0
        self._first: Counter[str] = Counter()
        self._gateways: dict[str, MoteReading] = {}
        self._by_gateway: Counter[str] = Counter()

    def note(self, reading: MoteReading, *, is_new: bool) -> None:
        """A reading has come; whether for the first time."""
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
        return [ForwarderCount(mote=mote, readings=readings) for mote, readings in ranked[:FORWARDERS_TOLD]]

    def gateways(self) -> list[GatewayCount]:
        """The gateways that have told readings, by name."""
        return [
            GatewayCount(
                name=name,
                readings=self._by_gateway[name],
                waiting=latest.waiting or 0,
                dropped=latest.dropped or 0,
                heard_ns=latest.stamp_ns,
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
        """As when it was first heard."""
        self.arrived = 0
        self.is_hopeless = False
        """Whether robots failed to collect there since it was last heard."""
        self._first_ns = taken_at_ns(reading)
        self._newest_ns = self._first_ns
        self._spoke_ns = self._first_ns
        self._numbers = 0
        """Readings that it has taken from the first that was heard to the newest, without that."""
        self._trend = CellTrend()

    def note(self, reading: MoteReading, *, is_new: bool) -> None:
        """A reading has come; one that another has taken in its place has no number, and tells nothing of its cells."""
        taken_ns = taken_at_ns(reading)
        self.arrived += is_new
        if reading.sequence is None:
            self._newest_ns = max(self._newest_ns, taken_ns)
            return
        is_latest = reading.sequence == self.latest.sequence  # told once more, with a new period perhaps
        if taken_ns < self._spoke_ns and not is_latest:
            return
        if self.latest.sequence is not None:
            self._numbers += (reading.sequence - self.latest.sequence) % SEQUENCES
        self.latest, self._spoke_ns = reading, max(self._spoke_ns, taken_ns)
        self._newest_ns = max(self._newest_ns, taken_ns)
        self.is_hopeless = False
        self._trend.note(to_seconds(taken_ns), reading.voltage_v)

    @property
    def place(self) -> Point2D | None:
        """Where it is, arena frame."""
        return self.latest.place

    @property
    def period_s(self) -> float:
        """How often it senses now."""
        return self.latest.period_s or self.usual_period_s

    @property
    def spoke_ns(self) -> int:
        """When the mote itself took the newest reading that has come."""
        return self._spoke_ns

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
        return to_seconds(max(0, now_ns - self._spoke_ns))

    def is_overdue(self, now_ns: int) -> bool:
        """Whether it has been silent for longer than a mote that is heard."""
        return self.silent_s(now_ns) > max(SILENT_S, PERIODS * self.period_s)

    def is_told_of(self, now_ns: int) -> bool:
        """Whether it, or a robot in its place, tells of the floor around it as often as is expected."""
        return self.age_s(now_ns) <= max(SILENT_S, PERIODS * self.period_s)

    def left_s(self, now_ns: int) -> float:
        """How long its cells still last if they go on as before; infinite if that is not known."""
        empty_s = self._trend.empty_s()
        return math.inf if empty_s is None else empty_s - to_seconds(now_ns)

    def is_dead(self, now_ns: int) -> bool:
        """Whether its cells are empty, as far as can be told."""
        if not self.is_overdue(now_ns):
            return False
        return self.is_hopeless or self.latest.voltage_v <= FLAT_V + NEARLY_FLAT_V or self.left_s(now_ns) <= 0

    def due(self, now_ns: int) -> float:
        """Readings that it took, or would have taken, since it was first heard, that first one included."""
        return 1.0 + self._numbers + max(0.0, self.silent_s(now_ns) - self.period_s) / self.period_s


class FieldLedger:
    """All motes that were ever heard."""

    def __init__(self, sensing_m: float) -> None:
        self.motes: dict[str, MoteLife] = {}
        self.ways = FieldWays()
        self._sieve = ReadingSieve()
        self._sensing_m = sensing_m
        self._placed: tuple[str, ...] = ()
        self._cover: CoverageMap | None = None

    def note(self, reading: MoteReading) -> None:
        """A reading has come, from a mote or from a robot in its place."""
        is_new = self._sieve.is_new(reading)
        mote = self.motes.get(reading.mote)
        if mote is None:
            if reading.sequence is None or len(self.motes) >= MOTES_MAX:
                return
            mote = self.motes[reading.mote] = MoteLife(reading)
        mote.note(reading, is_new=is_new)
        self.ways.note(reading, is_new=is_new)

    def placed(self) -> list[MoteLife]:
        """The motes that know where they are, by name."""
        return [mote for _, mote in sorted(self.motes.items()) if mote.place is not None]

    def cover(self) -> CoverageMap:
        """What each of `placed` covers of the floor between them, as far as any of them does."""
        placed = self.placed()
        names = tuple(mote.name for mote in placed)
        if self._cover is None or names != self._placed:
            self._placed = names
            self._cover = _cover_of([mote.place for mote in placed if mote.place is not None], self._sensing_m)
        return self._cover

    def state(self, on_duty: set[str], now_ns: int) -> MoteFieldState | None:
        """How the field is doing; None before a mote is heard.

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
        told = [index for index, mote in enumerate(self.placed()) if mote.is_told_of(now_ns)]
        due = sum(mote.due(now_ns) for mote in lives)
        half = (len(lives) + 1) // 2
        return MoteFieldState(
            motes=len(lives),
            dead=len(dead),
            delivery_ratio=round(min(1.0, sum(mote.arrived for mote in lives) / due), 4),
            age_s=round(sum(ages_s) / len(ages_s), 3) if ages_s else 0.0,
            oldest_s=round(max(ages_s, default=0.0), 3),
            coverage=round(self.cover().share(told), 4) if self.placed() else 0.0,
            on_duty=sum(mote.name in on_duty for mote in living),
            first_dead_ns=dead[0] if dead else None,
            half_dead_ns=dead[half - 1] if len(dead) >= half else None,
            last_dead_ns=dead[-1] if len(dead) == len(lives) else None,
            forwarded=self.ways.forwarded or UNSET,
            hops=self.ways.mean_hops or UNSET,
            forwarders=self.ways.forwarders() or UNSET,
            gateways=self.ways.gateways() or UNSET,
        )


def _cover_of(places: list[Point2D], sensing_m: float) -> CoverageMap:
    low_x_m, low_y_m = min(place.x_m for place in places), min(place.y_m for place in places)
    width_m, height_m = max(place.x_m for place in places) - low_x_m, max(place.y_m for place in places) - low_y_m
    steps = [(index + 0.5) / POINTS_A_SIDE for index in range(POINTS_A_SIDE)]
    points = [Point2D(low_x_m + x * width_m, low_y_m + y * height_m) for x in steps for y in steps]
    within = [
        point
        for point in points
        if any(math.hypot(place.x_m - point.x_m, place.y_m - point.y_m) <= sensing_m for place in places)
    ]
    return CoverageMap(places, within, sensing_m)
