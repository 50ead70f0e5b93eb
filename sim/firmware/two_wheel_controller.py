"""The motor controller of a base with two driven wheels: other frames than the Robertino's, big-endian, no checksums.

The simulated hull moves by three omni wheels; this controller turns them so that it moves as two wheels would, and
counts how far the two would have turned.
"""

from collections.abc import Callable

import can

from robrain.plugins.device.mocdevice.frame_map import Checksum, FrameMap, FrameSignals, StatusFrame, StopFrame, Unit
from robrain.plugins.device.mocdevice.signal_frame import SignalFrame, read_dbc
from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import BadFrame
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.navigation.omni_drive import OmniBase
from robrain.protocol.model.navigation.wheel_bases import Differential
from robrain.sim.firmware.motor_controller import MotorController, MotorState

DBC = "two_wheels"
FRAMES = FrameMap(
    dbc=DBC,
    commands=(FrameSignals(frame="DriveCommand", signals=("left_rpm", "right_rpm"), units=(Unit.RPM,)),),
    encoders=(
        FrameSignals(frame="LeftEncoder", signals=("left_counts",)),
        FrameSignals(frame="RightEncoder", signals=("right_counts",)),
    ),
    stop=StopFrame(frame=""),
    status=StatusFrame(frame="DriveState"),
    counter="",
    checksum=Checksum.NONE,
)
"""What a robot must know of these frames."""
HALF_TURN, MODULUS = 1 << 31, 1 << 32


def _codec(frame: str, *signals: str) -> SignalFrame:
    return SignalFrame(read_dbc(DBC).get_message_by_name(frame), signals, "", Checksum.NONE)


class TwoWheelController(MotorController):
    """See MotorController; `roll` follows the body in each tick, and `tell_counts` sends the encoders' frames.

    Args:
        bus: the robot's bus.
        base: the two wheels.
        hull: the wheels by which the simulated body moves.
        tick_s: how long a tick is.
        transmit_errors: of the node's CAN controller.

    """

    def __init__(
        self, bus: can.BusABC, base: Differential, hull: OmniBase, tick_s: float, transmit_errors: Callable[[], int]
    ) -> None:
        super().__init__(bus, hull, tick_s, transmit_errors)
        self._base, self._hull, self._tick_s = base, hull, tick_s
        self._two_wheels = frame_port(bus)
        self._wanted = _codec("DriveCommand", "left_rpm", "right_rpm")
        self._counts = (_codec("LeftEncoder", "left_counts"), _codec("RightEncoder", "right_counts"))
        self._state_frame = _codec("DriveState", "state", "fault")
        self._turns_rad = [0.0, 0.0]

    def receive(self, tick: int | None = None) -> None:
        """As MotorController."""
        self._received_tick = tick = self._received_tick + 1 if tick is None else tick
        before = self.state
        if self.has_failed:
            self._stand(MotorState.ERROR)
        for identifier, data, _ in self._two_wheels.take_frames():
            if identifier != self._wanted.arbitration_id:
                continue
            try:
                rpm = self._wanted.decode(data)
            except BadFrame:
                self.rejected_frames += 1
                continue
            if not any(rpm) and self.state is MotorState.ERROR and not self.has_failed:
                self._stand(MotorState.WATCHDOG)  # standing still acknowledges the failure
            elif self.state is not MotorState.ERROR:
                self._turn(*rpm)
        if tick >= self.due_tick:
            self._stand(MotorState.WATCHDOG)
        self.has_news |= self.state is not before

    def roll(self, forward_m: float, turned_rad: float) -> None:
        """Follow the body's motion of a tick."""
        for wheel, turn_rad in enumerate(self._base.wheel_speeds_rad_s(Twist2D(forward_m, 0.0, turned_rad))):
            self._turns_rad[wheel] += turn_rad

    def tell_counts(self) -> None:
        """Send the counts of both wheels."""
        for codec, turn_rad in zip(self._counts, self._turns_rad, strict=True):
            counts = int(turn_rad // self._base.rad_per_tick)
            data = codec.encode(0, (counts + HALF_TURN) % MODULUS - HALF_TURN)
            self._two_wheels.send_data(codec.arbitration_id, data)

    def tell(self) -> None:
        """As MotorController."""
        self.has_news = False
        data = self._state_frame.encode(0, self.state, int(self.has_failed))
        self._two_wheels.send_data(self._state_frame.arbitration_id, data)

    def _turn(self, left_rpm: float, right_rpm: float) -> None:
        per_rpm = 1.0 / Unit.RPM.per_si(self._base.wheel_radius_m)
        twist = self._base.twist(left_rpm * per_rpm, right_rpm * per_rpm)
        self._wanted_rad_s = self._hull.wheel_speeds_rad_s(twist)
        self.due_tick = self._received_tick + self._watchdog_ticks
        self.state = MotorState.RUNNING
