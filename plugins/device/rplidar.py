"""Slamtec's RPLIDAR A-series: a lidar on a serial line that takes the place of `scan`."""

from robrain.plugins.device.serial_lidar import SerialLidar
from robrain.protocol.lidar.points import LidarDecoder
from robrain.protocol.lidar.rplidar import RplidarDecoder


class Rplidar(SerialLidar):
    """Hands on each turn of Slamtec's RPLIDAR A-series."""

    has_dtr = False  # it stops the motor of an A1

    def decoder(self) -> LidarDecoder:
        return RplidarDecoder()
