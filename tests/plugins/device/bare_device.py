"""A device plugin without host or Zenoh; the test is the other end of its CAN bus."""

from collections import deque
from typing import Any

import can

from robrain.agent.board import Board
from robrain.agent.errors import HardwareAbsent
from robrain.agent.event import Event, Mailbox
from robrain.protocol.can.frames import codec
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.serial.serial_line import PortLine


class BareBus:
    """Frames that the device sends, and frames for it to receive."""

    def __init__(self) -> None:
        self.sent: list[can.Message] = []
        self.arrived: deque[can.Message] = deque()
        self.fails: Exception | None = None
        """Raised by every operation on the bus, if set."""
        self.is_open = True

    def send(self, frame: can.Message) -> None:
        if self.fails is not None:
            raise self.fails
        self.sent.append(frame)

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0, "a device does not wait for its bus"
        if self.fails is not None:
            raise self.fails
        return self.arrived.popleft() if self.arrived else None

    def shutdown(self) -> None:
        self.is_open = False


class BareDevice:
    """A device of this class with these parameters, not yet activated, and its recorded events."""

    robot, plugin = "r1", "device"

    def __init__(self, device_class: type, **parameters: Any) -> None:
        self.clock = VirtualClock(to_ns(100.0))
        self.board = Board()
        self.buses: list[BareBus] = []
        self.opened: list[tuple[str, str, dict[str, Any]]] = []
        self._mailbox = Mailbox()
        self.it = device_class(self, device_class.Parameters(**parameters))
        self.it.init()

    @property
    def bus(self) -> BareBus:
        """The bus opened last."""
        return self.buses[-1]

    def hurry(self) -> None:
        """The test steps the device itself."""

    def open_can(self, interface: str, channel: str, **options: Any) -> BareBus:
        self.opened.append((interface, channel, options))
        self.buses.append(BareBus())
        return self.bus

    def open_serial(self, port: str, baud: int, *, has_dtr: bool = True) -> PortLine:
        try:
            return PortLine(port, baud, has_dtr=has_dtr)
        except OSError as error:
            raise HardwareAbsent(self.plugin, str(error)) from error

    def told(self, event: Event[Any]) -> list[Any]:
        """A list to which each step appends an event's values."""
        values: list[Any] = []
        event.add(values.append, self._mailbox)
        return values

    def hear(self, name: str, counter: int, **signals: float) -> can.Message:
        """Deliver a frame now."""
        frame = codec(name).pack(counter, **signals)
        frame.timestamp = self.clock.now_ns() / 1e9
        self.bus.arrived.append(frame)
        return frame

    def wait(self, seconds: float) -> None:
        """Let time pass, without a step."""
        self.clock.advance_to(self.clock.now_ns() + to_ns(seconds))

    def step(self, after_s: float = 0.0) -> None:
        """Step the device after this time; its events are delivered even if it raises."""
        self.wait(after_s)
        try:
            self.it.step()
        finally:
            self._mailbox.deliver()

    def sent(self) -> list[tuple[str, dict[str, float]]]:
        """Frames sent since the last call, by name and signals."""
        frames, self.bus.sent = self.bus.sent, []
        names = {codec(name).arbitration_id: name for name in ("WheelCommand", "Stop")}
        return [(name := names[frame.arbitration_id], codec(name).unpack(frame)) for frame in frames]
