"""A device plugin on a real serial line, without host or Zenoh."""

from robrain.agent.errors import HardwareAbsent
from robrain.protocol.serial.serial_line import PortLine
from tests.plugins.device.bare_device import BareDevice


class SerialDevice(BareDevice):
    """A device whose line is a pseudo terminal."""

    def open_serial(self, port: str, baud: int, *, has_dtr: bool = True) -> PortLine:
        try:
            return PortLine(port, baud, has_dtr=has_dtr)
        except OSError as error:
            raise HardwareAbsent(self.plugin, str(error)) from error
