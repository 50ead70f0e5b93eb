"""The frames of WitMotion's units (WT901, WT61, JY901 and their kin), as their manual has them.

Eleven bytes: 0x55, the kind, four values of 16 bits, lower byte first, and the sum of the ten bytes before.
"""

import math
import struct

from robrain.plugins.device.imu.imu_codec import Motion

HEADER = 0x55
FRAME_BYTES = 11
ACCELERATION, ANGULAR_VELOCITY, LAST_KIND = 0x51, 0x52, 0x5F
FIRST_KIND = 0x50
ACCELERATION_M_S2 = 16 * 9.8 / 32768
"""Of one bit; the full scale is 16 g."""
ANGULAR_VELOCITY_RAD_S = math.radians(2000) / 32768
_VALUES = struct.Struct("<4h")


class WitMotionCodec:
    """See ImuCodec. An angular velocity is a measurement, with the acceleration that came last before it."""

    def __init__(self) -> None:
        self.rejected = self.stray_bytes = 0
        self._left = b""
        self._acceleration: tuple[float, float] | None = None

    def feed(self, data: bytes) -> list[Motion]:
        """As ImuCodec."""
        data, at, found = self._left + data, 0, []
        while len(data) - at >= FRAME_BYTES:
            frame = data[at : at + FRAME_BYTES]
            if frame[0] != HEADER or not FIRST_KIND <= frame[1] <= LAST_KIND:
                self.stray_bytes += 1
                at += 1
            elif sum(frame[:-1]) & 0xFF != frame[-1]:
                # It may be noise, or a byte is missing: the next frame may begin within this one.
                self.rejected += 1
                at += 1
            else:
                at += FRAME_BYTES
                if (motion := self._read(frame)) is not None:
                    found.append(motion)
        self._left = data[at:]
        return found

    def _read(self, frame: bytes) -> Motion | None:
        x, y, z, _ = _VALUES.unpack_from(frame, 2)
        if frame[1] == ACCELERATION:
            self._acceleration = x * ACCELERATION_M_S2, y * ACCELERATION_M_S2
        if frame[1] != ANGULAR_VELOCITY:
            return None
        acceleration, self._acceleration = self._acceleration, None
        return Motion(z * ANGULAR_VELOCITY_RAD_S, *(acceleration or ()))
