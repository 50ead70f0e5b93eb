"""LDROBOT's LD06 and LD19: a lidar on a serial line that takes the place of `scan`."""

from robrain.plugins.device.serial_lidar import SerialLidar
from robrain.protocol.lidar.ld19 import Ld19Decoder
from robrain.protocol.lidar.points import LidarDecoder


class Ld19(SerialLidar):
    """Hands on each turn of LDROBOT's LD06 and LD19."""

    def decoder(self) -> LidarDecoder:
        return Ld19Decoder()
