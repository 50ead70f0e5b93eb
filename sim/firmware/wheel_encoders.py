"""The encoder frames of all motor controllers at once."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.can.frames import codec

WHEELS = 3
ENCODER_FRAME = "WheelEncoders"
ENCODER_IDENTIFIER: int = codec(ENCODER_FRAME).arbitration_id
FRAME_BYTES = 2 * WHEELS + 2


class WheelEncoders:
    """Counts the ticks of the wheels' turns, 16 bits that wrap, and makes the frames that carry them.

    Args:
        ticks_per_rad: (N,) resolution of each robot's encoders.

    """

    def __init__(self, ticks_per_rad: Floats) -> None:
        self._ticks_per_rad = ticks_per_rad
        frame = codec(ENCODER_FRAME)
        self._crc_start, self._crc_table = frame.crc_start, np.array(frame.crc_table, np.uint8)
        self._sent = 0

    def frames(self, turns_rad: Floats) -> list[bytes]:
        """The next frame of each robot, for (N, 3) turns of the wheels since the start."""
        data = _frames(turns_rad, self._ticks_per_rad, self._sent & 0xFF, self._crc_start, self._crc_table).tobytes()
        self._sent += 1
        return [data[first : first + FRAME_BYTES] for first in range(0, len(data), FRAME_BYTES)]


@njit(cache=True)
def _frames(
    turns_rad: Floats, ticks_per_rad: Floats, counter: int, crc_start: int, crc_table: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """(N, 8) bytes as of the DBC file: three counts of 16 bits, the lowest byte first, counter and checksum."""
    frames = np.empty((turns_rad.shape[0], FRAME_BYTES), np.uint8)
    for i in range(turns_rad.shape[0]):
        frame = frames[i]
        for wheel in range(WHEELS):
            count = math.floor(turns_rad[i, wheel] * ticks_per_rad[i]) & 0xFFFF
            frame[2 * wheel] = count & 0xFF
            frame[2 * wheel + 1] = count >> 8
        frame[FRAME_BYTES - 2] = counter
        register = crc_start
        for place in range(FRAME_BYTES - 1):
            register = crc_table[register ^ frame[place]]
        frame[FRAME_BYTES - 1] = register ^ 0xFF
    return frames
