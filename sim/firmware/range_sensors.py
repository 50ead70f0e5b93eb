"""The range sensors and the bump ring: a node on the robot's CAN bus.

A ring of ultrasonic sensors looks outwards from the hull. A sensor receives the echo of the nearest object in its cone,
with some noise, and now and then no echo. Echoes off slanting walls and from other robots' sensors are left out. No
data sheet of the Robertino's sensors was found: number, range and cone are chosen in the manner of small ultrasonic
rangers.
"""

import math
from collections.abc import Sequence
from typing import Annotated

import can
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.plugins.device.range_sensors import NO_ECHO_M, RING_ANGLES_RAD, SENSORS_A_FRAME, SENSORS_MAX, bump_sector
from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import codec
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.ranges import NotNegative, Positive, Share

BUMP_PERIOD_S = 1.0
NEAREST_M = 0.02
"""Nearer than this a transducer still rings from its own pulse: it then reports this range."""
RAYS_A_CONE = 3
DRAWS = 240
"""Random numbers drawn at a time; a few at a time cost ten times as much."""


class RangeSensorSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Properties of the ring. Raises ValueError for invalid values."""

    angles_rad: Annotated[tuple[float, ...], Meta(max_length=SENSORS_MAX)] = RING_ANGLES_RAD
    """Directions of the sensors, robot's frame, counter-clockwise; empty for a robot without a ring."""
    rate_hz: Positive = 10.0
    range_max_m: Annotated[float, Meta(gt=0, lt=NO_ECHO_M)] = 2.0
    cone_rad: Annotated[float, Meta(ge=0, le=math.pi)] = math.radians(25.0)
    """Full width of a sensor's cone."""
    noise_m: NotNegative = 0.01
    """Standard deviation of a range."""
    dropout: Share = 0.02
    """Share of measurements without an echo, whatever the distance."""


class RangeSensors:
    """Measures all sensors at once and sends the ranges; reports a change of a bump contact at once.

    Args:
        bus: the robot's bus.
        spec: properties of the sensors.
        radius_m: of the hull that they sit on.
        walls: (H, W) solid cells; writable, as it would be copied otherwise.
        geometry: placement of `walls` in the arena frame.
        rng: draws noise and dropouts.
        tick_s: length of a tick.
        phase: ticks by which it measures later than others, so that the sensors do not all measure in the same tick.

    """

    def __init__(
        self,
        bus: can.BusABC,
        spec: RangeSensorSpec,
        radius_m: float,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        rng: np.random.Generator,
        tick_s: float,
        phase: int = 0,
    ) -> None:
        self.spec = spec
        self._port = frame_port(bus)
        self._radius_m = radius_m
        self._walls = walls
        self._geometry = geometry
        self._rng = rng
        sensors = len(spec.angles_rad)
        cone_rad = np.linspace(-spec.cone_rad / 2, spec.cone_rad / 2, RAYS_A_CONE)
        self._rays_rad = (np.array(spec.angles_rad)[:, None] + cone_rad[None, :]).ravel()
        self.period_ticks = max(1, round(1.0 / (spec.rate_hz * tick_s)))
        self.bump_period_ticks = max(1, round(BUMP_PERIOD_S / tick_s))
        self.phase = phase % self.period_ticks
        """Measurements and bump contacts are due in ticks that leave this when divided by the period of each."""
        self.reported = 0
        """The contacts that were reported last, a bit for each sector."""
        self._rings = [codec(f"RangeRing{number}") for number in range(1, math.ceil(sensors / SENSORS_A_FRAME) + 1)]
        self._silence = [NO_ECHO_M] * (len(self._rings) * SENSORS_A_FRAME - sensors)
        """Fills the last frame."""
        self._draws: list[tuple[float, bool]] = []
        self._bumps = codec("Bumps")
        self._sent = [0] * (len(self._rings) + 1)

    def measures_at(self, tick: int) -> bool:
        """Whether a measurement is due with this tick."""
        return bool(self._rings) and tick % self.period_ticks == self.phase

    def measure(self, pose: Pose2D, robots: NDArray[np.float64]) -> None:
        """Measure and send, from `pose`; `robots` (K, 3) are the hulls of all robots, as for the lidar."""
        ranges_m = self._measure(pose, robots) + self._silence
        for index, frame in enumerate(self._rings):
            first = index * SENSORS_A_FRAME
            data = frame.encode(self._sent[index], *ranges_m[first : first + SENSORS_A_FRAME])
            self._port.send_data(frame.arbitration_id, data)
            self._sent[index] += 1

    def feel(self, tick: int, yaw_rad: float, contacts_rad: Sequence[float]) -> None:
        """A tick in which the hull is touched from these directions of the arena frame.

        A tick may be skipped if there is no contact, was none at the last call, and no frame is due.
        """
        contacts = 0
        for direction_rad in contacts_rad:
            contacts |= 1 << bump_sector(direction_rad - yaw_rad)
        if contacts != self.reported or tick % self.bump_period_ticks == self.phase:
            if not self._rings:
                return
            self.reported = contacts
            self._port.send_data(self._bumps.arbitration_id, self._bumps.encode(self._sent[-1], contacts))
            self._sent[-1] += 1

    def _measure(self, pose: Pose2D, robots: NDArray[np.float64]) -> list[float]:
        spec = self.spec
        # Rays start at the centre and lose the hull's radius: the cone's tip lies there.
        reach_m = spec.range_max_m + self._radius_m
        ranges_m = cast_rays_of(self._walls, self._geometry, pose, self._rays_rad, reach_m, robots)
        if len(self._draws) < len(spec.angles_rad):
            self._draw()
        rays_m, found_m = ranges_m.tolist(), []
        # A few numbers: plain Python needs half the time of numpy here.
        for first in range(0, len(rays_m), RAYS_A_CONE):
            nearest_m = min(rays_m[first : first + RAYS_A_CONE]) - self._radius_m
            noise, is_dropped = self._draws.pop()
            measured_m = max(nearest_m + spec.noise_m * noise, NEAREST_M)
            is_lost = is_dropped or nearest_m >= spec.range_max_m or measured_m >= spec.range_max_m
            found_m.append(NO_ECHO_M if is_lost else measured_m)
        return found_m

    def _draw(self) -> None:
        noise, drops = self._rng.standard_normal(DRAWS).tolist(), self._rng.random(DRAWS) < self.spec.dropout
        self._draws = list(zip(noise, drops.tolist(), strict=True))
