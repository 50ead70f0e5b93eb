"""The mote field: sensor motes on the floor that wake, sense a temperature and send it to whoever is near.

Currents are those of the Mica2 in Shnayder et al.: Simulating the Power Consumption of Large-Scale Sensor Network
Applications, SenSys 2004, table 1. Durations, the batteries' curve and the temperatures are chosen.
"""

import heapq
import math
from collections.abc import Sequence

import msgspec
import numpy as np

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tinyos import BROADCAST, READING_TYPE, ActiveMessage, ReadingPayload
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topics import ARENA_RADIO_RX
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.radio import RadioLink, RadioModel
from robrain.sim.robot_body import RobotBody

PERIOD_S = 4.0
JITTER_S = 0.2
"""A mote's oscillator and its random back-off before it sends: uniform, either way."""
SENSOR_NOISE_C = 0.1

SLEEP_MA = 0.1
ACTIVE_MA = 8.0
SEND_MA = 3.7
"""The radio at −20 dBm, beside the active CPU (21.5 mA at its full 10 dBm)."""
ACTIVE_S = 0.02
SEND_S = 0.02
"""About 45 bytes with preamble at 19.2 kbit/s."""
CAPACITY_MAH = 2500.0
"""Two AA cells in series."""
FRESH_V, FLAT_V = 3.1, 2.1
USED_AT_START_MAX = 0.5
"""The batteries' used share at the start is drawn between 0 and this."""


class ArenaMote(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mote to be simulated: its name, its number on the air, and where it lies in the arena frame.

    Raises ValueError where it is built with a number that does not fit 16 bits.
    """

    name: str
    number: int
    place: Point2D

    def __post_init__(self) -> None:
        if not 0 <= self.number <= BROADCAST - 1:
            raise ValueError(f"expected {self.name}'s number from 0 to {BROADCAST - 1}, got {self.number}")


class TemperatureField(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Air temperature over the floor: a base and one warm plume of Gaussian shape."""

    base_c: float = 20.0
    plume_c: float = 9.0
    """How much warmer the plume's middle is."""
    plume_at: Point2D
    plume_width_m: float = 3.0
    """Standard deviation of its shape."""

    def temperature_c(self, place: Point2D) -> float:
        """Temperature at a place of the arena frame."""
        distance = math.hypot(place.x_m - self.plume_at.x_m, place.y_m - self.plume_at.y_m) / self.plume_width_m
        return self.base_c + self.plume_c * math.exp(-0.5 * distance * distance)

    @classmethod
    def draw(cls, plan: FloorPlan, rng: np.random.Generator) -> "TemperatureField":
        """A field whose plume stands on a random free cell of the plan."""
        rows, columns = np.nonzero(~plan.occupied)
        cell = int(rng.integers(len(rows)))
        return cls(plume_at=plan.centre_of(int(rows[cell]), int(columns[cell])))


class MoteField:
    """All motes, woken in order of time.

    Args:
        motes: what lies where; the order decides who gets which randomness.
        robots: names of the robots with a base station, in the order in which `step()` gets their bodies.
        field: what is sensed.
        endpoint: where packets that are heard are put.
        rng: source of the motes' randomness.
        tick_s: how long a tick is.
        radio: how far packets are heard.

    """

    def __init__(
        self,
        motes: Sequence[ArenaMote],
        robots: Sequence[str],
        field: TemperatureField,
        endpoint: Endpoint,
        rng: np.random.Generator,
        tick_s: float,
        radio: RadioModel | None = None,
    ) -> None:
        radio = radio if radio is not None else RadioModel()
        self._receivers = [endpoint.publisher(ARENA_RADIO_RX, robot=robot) for robot in robots]
        self._motes = [
            _Mote(mote, field.temperature_c(mote.place), len(robots), radio, mote_rng, tick_s)
            for mote, mote_rng in zip(motes, rng.spawn(len(motes)), strict=True)
        ]
        self._tick = 0
        self._wake_ticks = [(mote.first_tick, index) for index, mote in enumerate(self._motes)]
        heapq.heapify(self._wake_ticks)

    def step(self, robots: Sequence[RobotBody]) -> None:
        """Go on by a tick: motes whose time has come sense and send to the robots in reach."""
        self._tick += 1
        while self._wake_ticks and self._wake_ticks[0][0] <= self._tick:
            tick, index = self._wake_ticks[0]
            mote = self._motes[index]
            if mote.is_flat:
                heapq.heappop(self._wake_ticks)
                continue
            mote.wake(tick, robots, self._receivers)
            heapq.heapreplace(self._wake_ticks, (mote.next_tick(tick), index))


class _Mote:
    """One mote with its batteries and its links to the robots."""

    def __init__(
        self,
        spec: ArenaMote,
        temperature_c: float,
        robots: int,
        radio: RadioModel,
        rng: np.random.Generator,
        tick_s: float,
    ) -> None:
        self._spec = spec
        self._temperature_c = temperature_c
        self._tick_s = tick_s
        self._rng = rng
        self._links = [RadioLink(radio, link_rng) for link_rng in rng.spawn(robots)]
        self._used_mah = CAPACITY_MAH * self._rng.uniform(0.0, USED_AT_START_MAX)
        self._slept_from_tick = 0
        self._sequence = 0
        self.first_tick = 1 + int(self._rng.uniform(0.0, PERIOD_S) / tick_s)

    @property
    def is_flat(self) -> bool:
        """Whether its batteries are used up."""
        return self._used_mah >= CAPACITY_MAH

    def next_tick(self, tick: int) -> int:
        """When it wakes again, having woken at `tick`."""
        return tick + max(1, round((PERIOD_S + self._rng.uniform(-JITTER_S, JITTER_S)) / self._tick_s))

    def wake(self, tick: int, robots: Sequence[RobotBody], receivers: Sequence[Publisher]) -> None:
        """Sense, and send one packet; each robot that hears it gets it with its own signal strength."""
        self._use_energy(tick)
        reading_c = self._temperature_c + SENSOR_NOISE_C * self._rng.standard_normal()
        place = self._spec.place
        reading = ReadingPayload(
            mote=self._spec.number,
            sequence=self._sequence & 0xFFFF,
            voltage_mv=round(1000.0 * (FRESH_V + (FLAT_V - FRESH_V) * self._used_mah / CAPACITY_MAH)),
            reading_centi=round(100.0 * reading_c),
            x_dm=round(10.0 * place.x_m),
            y_dm=round(10.0 * place.y_m),
        )
        self._sequence += 1
        for robot, link, receiver in zip(robots, self._links, receivers, strict=True):
            rssi_dbm = link.receive_dbm(math.hypot(robot.x_m - place.x_m, robot.y_m - place.y_m))
            if rssi_dbm is not None:
                heard = msgspec.structs.replace(reading, rssi_dbm=max(-128, min(127, round(rssi_dbm))))
                message = ActiveMessage(type=READING_TYPE, payload=heard.pack(), source=self._spec.number)
                receiver.put_bytes(message.pack())

    def _use_energy(self, tick: int) -> None:
        slept_s = (tick - self._slept_from_tick) * self._tick_s
        self._slept_from_tick = tick
        charge_mas = SLEEP_MA * slept_s + ACTIVE_MA * (ACTIVE_S + SEND_S) + SEND_MA * SEND_S
        self._used_mah += charge_mas / 3600.0
