"""A WitMotion WT901 on a serial line: the bytes that it sends for a motion, with the errors of its gyroscope."""

import math
import struct

import numpy as np

ACCELERATION_BIT_M_S2 = 16 * 9.8 / 32768
RATE_BIT_RAD_S = math.radians(2000) / 32768
GRAVITY_M_S2 = 9.81
TEMPERATURE_BITS = 2500
"""25 °C in hundredths of a degree."""


def wit_frame(kind: int, *values: int) -> bytes:
    """One frame: header, kind, four values of 16 bits, and the sum of the bytes before."""
    body = struct.pack("<BB4h", 0x55, kind, *(max(-0x8000, min(0x7FFF, value)) for value in values))
    return body + bytes((sum(body) & 0xFF,))


class WitImu:
    """Frames of acceleration and angular velocity at a constant rate.

    Args:
        rng: of the noise.
        rate_hz: measurements a second.
        bias_rad_s: of the gyroscope about its vertical axis.
        noise_rad_s: standard deviation of one measurement.

    """

    def __init__(
        self, rng: np.random.Generator, *, rate_hz: float = 100.0, bias_rad_s: float = 0.0, noise_rad_s: float = 0.002
    ) -> None:
        self.bias_rad_s = bias_rad_s
        self._rng, self._period_s, self._noise_rad_s = rng, 1.0 / rate_hz, noise_rad_s
        self._due_s = 0.0

    def run(self, yaw_rate_rad_s: float, duration_s: float, forward_m_s2: float = 0.0) -> bytes:
        """What is sent in a time in which the unit turns and accelerates like this."""
        self._due_s += duration_s
        data = b""
        while self._due_s >= self._period_s - 1e-9:
            self._due_s -= self._period_s
            measured_rad_s = yaw_rate_rad_s + self.bias_rad_s + float(self._rng.normal(0.0, self._noise_rad_s))
            x, z = round(forward_m_s2 / ACCELERATION_BIT_M_S2), round(GRAVITY_M_S2 / ACCELERATION_BIT_M_S2)
            data += wit_frame(0x51, x, 0, z, TEMPERATURE_BITS)
            data += wit_frame(0x52, 0, 0, round(measured_rad_s / RATE_BIT_RAD_S), TEMPERATURE_BITS)
        return data
