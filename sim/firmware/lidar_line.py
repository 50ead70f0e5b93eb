"""A simulated lidar as bytes on a serial line, as an LD19 or an RPLIDAR sends them."""

from collections.abc import Callable
from enum import StrEnum

import numpy as np

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.serial.ld19 import POINTS, encode_ld19
from robrain.protocol.serial.rplidar import DESCRIPTOR, encode_rplidar

LD19_PACKETS = 38
"""Of a turn at 10 Hz: 4,500 points a second."""
RPLIDAR_POINTS = 360
LINE = "lidar"
"""Name of the line."""


class LidarProtocol(StrEnum):
    """Protocol of a simulated lidar."""

    WIRE = "wire"
    """Scans over the wire, for the plugin `scan`."""
    LD19 = "ld19"
    """Bytes of an LD19, for the plugin `ld19`."""
    RPLIDAR = "rplidar"
    """Bytes of an RPLIDAR A1, for the plugin `rplidar`."""


class LidarLine:
    """A lidar that turns: in each tick it measures the next directions, and sends their bytes.

    Args:
        protocol: not `WIRE`.
        rate_hz: turns a second.
        tick_s: length of a tick.
        measure: ranges (N,) in metres in these directions (N,), radians counter-clockwise in the robot's frame; 0 for
            no return.
        put: sends bytes on the line.

    """

    def __init__(
        self,
        protocol: LidarProtocol,
        rate_hz: float,
        tick_s: float,
        measure: Callable[[Floats], Floats],
        put: Callable[[bytes], None],
    ) -> None:
        self._is_ld19 = protocol is LidarProtocol.LD19
        self._rate_hz, self._tick_s, self._measure, self._put = rate_hz, tick_s, measure, put
        self._per_packet = POINTS if self._is_ld19 else 1
        self._packets = LD19_PACKETS if self._is_ld19 else RPLIDAR_POINTS
        """Of a turn."""
        self._step_deg = 360.0 / (self._packets * self._per_packet)
        self._ticks = self._sent = 0

    def turn(self) -> None:
        """Turn for a tick."""
        self._ticks += 1
        first, self._sent = self._sent, int(self._ticks * self._tick_s * self._rate_hz * self._packets)
        if first == self._sent:
            return
        points = np.arange(first * self._per_packet, self._sent * self._per_packet)
        clockwise_deg = (points % (self._packets * self._per_packet)) * self._step_deg
        ranges_m = self._measure(-np.radians(clockwise_deg)).tolist()
        if not self._is_ld19:
            nodes = encode_rplidar(clockwise_deg.tolist(), ranges_m)
            self._put(nodes if first else DESCRIPTOR + nodes)  # it was asked before the arena began
            return
        packets = []
        for number in range(self._sent - first):
            begin = number * POINTS
            stamp_ms = round(1000 * (first + number) / (self._packets * self._rate_hz))
            speed_deg_s = round(360 * self._rate_hz)
            packet_m = ranges_m[begin : begin + POINTS]
            packets.append(encode_ld19(float(clockwise_deg[begin]), self._step_deg, packet_m, speed_deg_s, stamp_ms))
        self._put(b"".join(packets))
