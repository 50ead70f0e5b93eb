"""Motor controller on CAN: by its defaults that of a base with three omni wheels in the style of the Robertino.

Another base is a matter of parameters: its kinematics (`base`), and the frames of its DBC file (`frames`).
"""

import logging
from typing import Any

import msgspec

from robrain.plugins.device.mocdevice.can_link import CanLink
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.plugins.device.mocdevice.frame_map import FrameMap
from robrain.plugins.device.mocdevice.odometry import Counting
from robrain.plugins.device.mocdevice.wheel_device import OpenLink, WheelDevice
from robrain.plugins.device.mocdevice.wheel_frames import SPEED_TICKS_PER_RAD, WheelFrames
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.navigation.wheel_bases import Ackermann

logger = logging.getLogger(__name__)

STAMPS_SENDING = "zenoh"
"""Name of the interface whose frames carry stamps of the sender."""


class MocDevice(WheelDevice):
    """Turns velocities into wheel commands and encoder counts into odometry."""

    class Parameters(WheelDevice.Parameters, msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`interface` and `channel` are python-can's; the default wheel sizes are chosen, no data sheet was found."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = {}
        """Other options of python-can's interface, such as `bitrate` or `port`."""
        frames: FrameMap = FrameMap()
        """Frames and signals of the controller."""
        stamped_at: StampedAt | None = None
        """Meaning of the interface's time stamps; None is `sending` for `zenoh` and `arrival` for all others."""

    parameters: Parameters

    def open_link(self) -> OpenLink:
        wanted, base = self.parameters, self.parameters.base
        commands = len(base.commands(Twist2D(), wanted.wheel_speed_max_rad_s))
        frames = WheelFrames(wanted.frames, commands, base.wheels, base.wheel_radius_m)
        fastest = wanted.wheel_speed_max_rad_s
        frames.check_limits((fastest, base.steering_max_rad) if isinstance(base, Ackermann) else (fastest,) * commands)
        robot = self.env.robot
        bus = self.env.open_can(wanted.interface, wanted.channel, **wanted.options)
        link = CanLink(bus, frames, self.env.plugin, lambda what: logger.warning("%s: %s", robot, what))
        stamped_at = wanted.stamped_at
        if stamped_at is None:
            stamped_at = StampedAt.SENDING if wanted.interface == STAMPS_SENDING else StampedAt.ARRIVAL
        rad_per_tick = 1.0 / SPEED_TICKS_PER_RAD if frames.is_speed else base.rad_per_tick
        return OpenLink(
            link,
            f"the CAN bus {wanted.interface}:{wanted.channel} is cut or its controller gone",
            Counting(frames.modulus, rad_per_tick),
            frames.period_s,
            stamped_at,
        )
