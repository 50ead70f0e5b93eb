"""One simulated mote: firmware that senses, logs, sends and listens, with a clock that drifts and a battery.

The radio delivers packets to the mote and sends the mote's packets; `motes` decides on their receivers. Durations are
chosen.
"""

import math
from collections import deque
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NotNegative, Positive, Share
from robrain.protocol.tinyos.packet import BROADCAST, ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    CENTI,
    DECI,
    DUTY_TYPE,
    HOPS_MAX,
    PERIOD_MAX_S,
    PERIOD_MIN_S,
    READING_TYPE,
    REQUEST_TYPE,
    SEQUENCES,
    STORED_TYPE,
    DutyPayload,
    Quantity,
    ReadingPayload,
    RequestPayload,
    SequenceRange,
    sequences_after,
)
from robrain.sim.motes.field import SimulatedField
from robrain.sim.motes.radio import AIRTIME_S, MoteBattery, MoteState

QUEUE_MAX = 1024


class MeshSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[motes.mesh]`: readings that travel over neighbours to a robot or gateway. All defaults are chosen.

    Raises ValueError where a number is out of range.
    """

    hops: Annotated[int, Meta(ge=0, le=HOPS_MAX)] = 0
    """Largest number of motes that forward a reading; 0: motes do not receive each other's packets."""
    tries: Annotated[int, Meta(ge=1, le=255)] = 4
    """Packets in a row that a next hop may leave unacknowledged before the mote pauses, each time for longer."""
    queue: Annotated[int, Meta(ge=1, le=QUEUE_MAX)] = 16
    """Readings that a mote holds to pass them on; it acknowledges none while it has no room."""
    duty: Share = 0.01
    """Share of the time in which a mote listens for its neighbours, at moments that they have agreed on."""
    wake_s: Positive = 0.5
    """Interval of these moments, which a reading waits at each mote that passes it on."""
    routes_s: Positive = 30.0
    """Interval at which motes choose their next hops again; each sends a beacon for it and receives its neighbours'."""


SENSE_S = 0.02
LOG_S = 0.001
"""A page of the flash memory needs some 14 ms and holds ten readings."""
CHECK_S = 0.003
"""Low-power listening: time for which the radio is on to check whether a sender is active."""
ANSWER_GAP_S = 0.04
"""Between two stored readings."""
MAX_ANSWERS = 64
"""Stored readings that wait to be sent; a request for more is cut to this number."""
MAX_GATEWAY_READINGS = 10_000_000
MAX_LOG = 30_000
"""Less than half of all sequence numbers, so that older and newer are distinguishable."""
PPM = 1e-6


class MoteSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Properties of the motes of a scenario: its table `[motes]`. All defaults are chosen.

    Raises ValueError where it is built with a value without sense.
    """

    period_s: Annotated[float, Meta(ge=PERIOD_MIN_S, le=PERIOD_MAX_S)] = 4.0
    """Time between two readings, until a robot sets another."""
    jitter_s: float = 0.2
    """Random back-off before it sends: uniform from minus to plus this."""
    listen_s: NotNegative = 0.2
    """Time for which it listens after each packet that it has sent."""
    check_s: NotNegative = 0.0
    """Low-power listening (B-MAC, Polastre et al., SenSys 2004): interval at which it checks the channel, and length of
    the preamble; 0 for never."""
    drift_ppm: NotNegative = 30.0
    """Standard deviation of the clocks' rates, parts per million."""
    log_readings: Annotated[int, Meta(ge=1, le=MAX_LOG)] = 1024
    """Number of unacknowledged readings that are kept; beyond it the oldest is lost."""
    capacity_mah: Positive = 2500.0
    """Capacity of its batteries."""
    used_at_start_max: Share = 0.5
    """The used share of the batteries at the start is drawn between 0 and this."""
    quantities: tuple[Literal["temperature", "light", "humidity"], ...] = ("temperature",)
    """Quantities that the motes measure, in turn: the first mote the first of these."""
    mesh: MeshSpec = MeshSpec()
    """Settings of forwarding between motes; by default they do not forward."""
    gateways: tuple[str, ...] = ()
    """Motes beside which a gateway stands, with mains power and a radio of the team's network; and robots that are
    gateways. A gateway stores readings while the coordinator is out of reach.
    """
    gateway_readings: Annotated[int, Meta(ge=1, le=MAX_GATEWAY_READINGS)] = 4096
    """Number of readings that a gateway stores. When it is full, the oldest of the mote with the most is dropped."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.jitter_s < self.period_s:
            raise ValueError(f"expected jitter_s at least 0 and below period_s, got {self.jitter_s}")
        if not self.quantities:
            raise ValueError("expected quantities to name at least one")


class ArenaMote(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mote to be simulated: its name, its number on the air, and where it lies in the arena frame.

    Raises ValueError where it is built with a number that does not fit 16 bits.
    """

    name: str
    number: Annotated[int, Meta(ge=0, le=BROADCAST - 1)]
    place: Point2D


class ReadingLog:
    """Readings in the flash memory that are not acknowledged yet; a ring, numbered without wrap."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._numbers = np.full(capacity, -1, np.int64)
        self._values_centi = np.zeros(capacity, np.int32)
        self._sensed_s = np.zeros(capacity)
        self._oldest = 0
        self.lost = 0
        """Readings that were overwritten before anybody had acknowledged them."""

    def add(self, number: int, value_centi: int, sensed_s: float) -> None:
        """Keep the next reading."""
        slot = number % len(self._numbers)
        self.lost += self._numbers[slot] >= 0
        self._numbers[slot], self._values_centi[slot], self._sensed_s[slot] = number, value_centi, sensed_s

    def __contains__(self, number: int) -> bool:
        return number >= 0 and bool(self._numbers[number % len(self._numbers)] == number)

    def get(self, number: int) -> tuple[int, float]:
        """Value in hundredths, and when it was taken (KeyError if it is not held)."""
        if number not in self:
            raise KeyError(number)
        slot = number % len(self._numbers)
        return int(self._values_centi[slot]), float(self._sensed_s[slot])

    def forget(self, number: int) -> None:
        """It was acknowledged."""
        if number in self:
            self._numbers[number % len(self._numbers)] = -1

    def oldest(self, newest: int) -> int:
        """The lowest number that is held, or `newest` if none is."""
        self._oldest = max(self._oldest, newest - len(self._numbers) + 1)
        while self._oldest < newest and self._oldest not in self:
            self._oldest += 1
        return self._oldest


class SimulatedMote:
    """One mote, driven tick by tick by its field.

    Args:
        mote: name and place.
        spec: properties of the mote.
        quantity: the field that it senses.
        transmit_dbm: power of its radio.
        rng: the mote's own.
        tick_s: length of a tick.

    """

    def __init__(
        self,
        mote: ArenaMote,
        spec: MoteSpec,
        quantity: Quantity,
        transmit_dbm: float,
        rng: np.random.Generator,
        tick_s: float,
    ) -> None:
        self.mote = mote
        self.log = ReadingLog(spec.log_readings)
        self.battery = MoteBattery(spec.capacity_mah, rng.uniform(0.0, spec.used_at_start_max), transmit_dbm)
        self.period_ds = round(DECI * spec.period_s)
        self._spec = spec
        self._mesh_duty = spec.mesh.duty if spec.mesh.hops else 0.0
        self._quantity = quantity
        self._rng = rng
        self._tick_s = tick_s
        self._rate = 1.0 + PPM * spec.drift_ppm * rng.standard_normal()
        """True seconds that pass in a second of its clock."""
        self._due_s = spec.period_s * rng.uniform()
        self._sense_tick = self._tick_of(self._due_s, 0)
        self._answers: deque[int] = deque()
        self._answer_tick = 0
        self._newest = -1
        self._awake_tick = 0
        self._awake_s = 0.0
        self._listens_until_tick = -1

    @property
    def next_tick(self) -> int:
        """Time of its next waking."""
        return min(self._sense_tick, self._answer_tick) if self._answers else self._sense_tick

    @property
    def newest(self) -> int:
        """Number of its newest reading, without wrap; -1 before the first."""
        return self._newest

    def stored(self, number: int, tick: int) -> ReadingPayload | None:
        """A reading in its log, as it would send it now; None if the log has lost it."""
        return self._payload(number, tick) if number in self.log else None

    def listens_at(self, tick: int) -> bool:
        """Whether a packet sent to it now finds its radio on."""
        return not self.battery.is_flat and (self._spec.check_s > 0 or tick <= self._listens_until_tick)

    def wake(self, tick: int, field: SimulatedField) -> ActiveMessage:
        """Do everything that is due; returns the packet that it sends."""
        self._sleep_until(tick)
        if self._answers and self._answer_tick <= tick:
            number = self._answers.popleft()
            self._answer_tick = tick + max(1, round(ANSWER_GAP_S / self._tick_s))
            busy_s = 0.0
            kind = STORED_TYPE
        else:
            number = self._sense(tick, field)
            busy_s = SENSE_S + LOG_S
            kind = READING_TYPE
        self.battery.spend(MoteState.SEND, AIRTIME_S)
        self._awake_s = busy_s + AIRTIME_S
        self._listens_until_tick = tick + 1 + round(self._spec.listen_s / self._tick_s)
        return ActiveMessage(type=kind, payload=self._payload(number, tick).pack(), source=self.mote.number)

    def receive(self, message: ActiveMessage, tick: int) -> None:
        """A packet for it has arrived; an unknown packet is ignored."""
        if tick > self._listens_until_tick:  # received with low-power listening: on the average half of the preamble
            self.battery.spend(MoteState.LISTEN, 0.5 * self._spec.check_s)
        try:
            if message.type == REQUEST_TYPE:
                self._queue(self._asked(RequestPayload.unpack(message.payload)), tick)
            elif message.type == ACKNOWLEDGE_TYPE:
                self._forget(self._numbers(SequenceRange.unpack(message.payload)))
            elif message.type == DUTY_TYPE:
                self._set_period(DutyPayload.unpack(message.payload).period_ds, tick)
        except BadPacket:
            return

    def _sense(self, tick: int, field: SimulatedField) -> int:
        self.battery.spend(MoteState.SENSE, SENSE_S)
        self.battery.spend(MoteState.LOG, LOG_S)
        now_s = tick * self._tick_s
        noise = field.spec.levels(self._quantity).noise
        value = field.value(self._quantity, self.mote.place, now_s) + noise * self._rng.standard_normal()
        self._newest += 1
        self.log.add(self._newest, round(CENTI * value), now_s)
        self._drop_answers()
        jitter_s = self._rng.uniform(-self._spec.jitter_s, self._spec.jitter_s)
        self._due_s += self._rate * self.period_ds / DECI
        self._sense_tick = self._tick_of(self._due_s + jitter_s, tick)
        return self._newest

    def _payload(self, number: int, tick: int) -> ReadingPayload:
        value_centi, sensed_s = self.log.get(number)
        place = self.mote.place
        return ReadingPayload(
            mote=self.mote.number,
            sequence=number % SEQUENCES,
            oldest=self.log.oldest(number) % SEQUENCES,
            age_ds=round(DECI * (tick * self._tick_s - sensed_s) / self._rate),
            period_ds=self.period_ds,
            voltage_mv=round(1000.0 * self.battery.voltage_v),
            quantity=self._quantity,
            value_centi=value_centi,
            x_dm=round(DECI * place.x_m),
            y_dm=round(DECI * place.y_m),
        )

    def _asked(self, request: RequestPayload) -> list[int]:
        """Numbers that are asked for and held, oldest first."""
        if self._newest < 0:
            return []
        numbers = [self._newest + sequences_after(each, self._newest % SEQUENCES) for each in request.sequences()]
        return [number for number in numbers if number in self.log]

    def _numbers(self, wanted: SequenceRange) -> list[int]:
        """Numbers in a range that its log holds, oldest first."""
        if self._newest < 0:
            return []
        numbers = range(self.log.oldest(self._newest), self._newest + 1)
        return [number for number in numbers if wanted.holds(number % SEQUENCES) and number in self.log]

    def _forget(self, numbers: list[int]) -> None:
        for number in numbers:
            self.log.forget(number)
        self._drop_answers()

    def _drop_answers(self) -> None:
        """Do not answer with readings that the log has lost."""
        if self._answers:
            self._answers = deque(number for number in self._answers if number in self.log)

    def _queue(self, numbers: list[int], tick: int) -> None:
        room = MAX_ANSWERS - len(self._answers)
        if not self._answers:
            self._answer_tick = tick + 1
        self._answers += [number for number in numbers if number not in self._answers][:room]

    def _set_period(self, period_ds: int, tick: int) -> None:
        if period_ds != self.period_ds:
            self.period_ds = period_ds
            self._due_s = tick * self._tick_s + self._rate * period_ds / DECI
            self._sense_tick = self._tick_of(self._due_s, tick)
        # The newest reading, sent once more, confirms that the duty was received.
        self._queue([self._newest] if self._newest in self.log else [], tick)

    def _sleep_until(self, tick: int) -> None:
        """Count the time since it last woke: its activity then, listening, and sleep."""
        passed_s = max(0.0, (tick - self._awake_tick) * self._tick_s - self._awake_s)
        listened_s = min(passed_s, self._spec.listen_s) if self._newest >= 0 else 0.0
        slept_s = passed_s - listened_s
        if self._spec.check_s > 0:
            checked_s = slept_s * CHECK_S / (CHECK_S + self._spec.check_s)
            listened_s, slept_s = listened_s + checked_s, slept_s - checked_s
        if self._mesh_duty:
            listened_s, slept_s = listened_s + slept_s * self._mesh_duty, slept_s * (1.0 - self._mesh_duty)
        self.battery.spend(MoteState.LISTEN, listened_s)
        self.battery.spend(MoteState.SLEEP, slept_s)
        self._awake_tick = tick

    def _tick_of(self, time_s: float, after: int) -> int:
        return max(after + 1, math.ceil(time_s / self._tick_s))
