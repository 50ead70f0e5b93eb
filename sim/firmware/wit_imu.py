"""A WitMotion WT901 on a serial line: the bytes that it sends for a motion, with the errors of its gyroscope."""

import math
import struct
from typing import Annotated

import numpy as np
from msgspec import Meta

from robrain.protocol.model.checked import Checked

IMU_LINE = "imu"
"""Name of the line."""

ACCELERATION_BIT_M_S2 = 16 * 9.8 / 32768
RATE_BIT_RAD_S = math.radians(2000) / 32768
GRAVITY_M_S2 = 9.81
TEMPERATURE_BITS = 2500
"""25 °C in hundredths of a degree."""


class ImuSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An inertial measurement unit on a serial line, for the plugin `serial_imu`.

    Raises ValueError for values without sense.
    """

    rate_hz: Annotated[float, Meta(gt=0, lt=1000.0)] = 100.0
    """Measurements a second."""
    bias_rad_s: float = 0.0
    """Of the gyroscope about its vertical axis."""
    noise_rad_s: Annotated[float, Meta(ge=0, lt=10)] = 0.002
    """Standard deviation of one measurement of the turn rate."""
    upside_down: bool = False
    """Its z axis points down."""


def wit_frame(kind: int, *values: int) -> bytes:
    """One frame: header, kind, four values of 16 bits, and the sum of the bytes before."""
    body = struct.pack("<BB4h", 0x55, kind, *(max(-0x8000, min(0x7FFF, value)) for value in values))
    return body + bytes((sum(body) & 0xFF,))


class WitImu:
    """Frames of acceleration and angular velocity at a constant rate.

    Args:
        spec: its properties and its mount.
        rng: of the noise.

    """

    def __init__(self, spec: ImuSpec, rng: np.random.Generator) -> None:
        self._spec, self._rng, self._period_s = spec, rng, 1.0 / spec.rate_hz
        self._sign = -1.0 if spec.upside_down else 1.0
        self._due_s = 0.0

    def run(self, yaw_rate_rad_s: float, duration_s: float, forward_m_s2: float = 0.0) -> bytes:
        """Packets sent during a time in which the robot turns and accelerates like this."""
        spec = self._spec
        self._due_s += duration_s
        data = b""
        while self._due_s >= self._period_s - 1e-9:
            self._due_s -= self._period_s
            noise_rad_s = float(self._rng.normal(0.0, spec.noise_rad_s))
            measured_rad_s = self._sign * yaw_rate_rad_s + spec.bias_rad_s + noise_rad_s
            x, z = round(forward_m_s2 / ACCELERATION_BIT_M_S2), round(self._sign * GRAVITY_M_S2 / ACCELERATION_BIT_M_S2)
            data += wit_frame(0x51, x, 0, z, TEMPERATURE_BITS)
            data += wit_frame(0x52, 0, 0, round(measured_rad_s / RATE_BIT_RAD_S), TEMPERATURE_BITS)
        return data
