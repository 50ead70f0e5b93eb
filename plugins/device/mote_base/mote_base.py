"""Base station of the mote network: TinyOS packets from the air and to it, over any kind of line."""

import socket
from collections import deque
from typing import Annotated, Literal

import msgspec
import serial
from msgspec import Meta

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.plugins.device.mote_base.interface import MoteBaseInterface, ReceivedPacket, Trouble
from robrain.protocol.backoff import Backoff
from robrain.protocol.clock import NS_PER_S, to_ns, to_seconds
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, NotNegativeInt, Positive, PositiveInt
from robrain.protocol.serial.serial_line import write_at_once
from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.serial_forwarder import DEFAULT_PORT, GREETING, BadGreeting, PacketDecoder, encode
from robrain.protocol.tinyos.serial_line import SerialLink


class LineAbsent(OSError):
    """The base station, or its line, is not there.

    A fault like others: the plugin is started again later.
    """


class PacketLink:
    """Carries whole packets. It never waits: it is called in the device's step.

    Args:
        where: name of the line, for reasons.
        backoff: when to open a lost line again.

    """

    def __init__(self, where: str, backoff: Backoff) -> None:
        self.down_reason = ""
        """Reason why the line is lost; empty while it is open."""
        self.dropped = 0
        """Packets that came while too many waited already."""
        self._where, self._backoff = where, backoff

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets that have arrived; the call also tries to reopen a lost line."""
        raise NotImplementedError

    def send(self, packet: bytes, now_ns: int) -> None:
        """Send a packet; one that the line cannot accept is counted."""
        raise NotImplementedError

    def counters(self) -> dict[str, int]:
        """Counters of this kind of line."""
        return {}

    def close(self) -> None:
        """Close the line."""

    def _lose(self, reason: object, now_ns: int) -> None:
        self.close()
        self.down_reason = f"{self._where}: {reason}"
        if self._is_due(now_ns):
            self._backoff.fail(to_seconds(now_ns))

    def _is_due(self, now_ns: int) -> bool:
        return self._backoff.is_due(to_seconds(now_ns))


SERIAL_CHUNK_BYTES = 16_384


class SerialLineLink(PacketLink):
    """A base station's serial line.

    Args:
        wanted: the line, and how often a packet is sent again.
        backoff: when to open the line again.

    Raises:
        OSError: it cannot be opened (pyserial's errors are such).
        ValueError: the line cannot be as fast.

    """

    def __init__(self, wanted: "MoteBase.Parameters", backoff: Backoff) -> None:
        super().__init__(wanted.device, backoff)
        self._baud = wanted.baud
        self._reopened = 0
        self._left = b""
        self._link = SerialLink(ack_timeout_ns=to_ns(wanted.ack_timeout_s), resends=wanted.resends)
        self._port: serial.Serial | None = self._open()

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step; the call also repeats unacknowledged packets."""
        if self._port is None:
            if self._is_due(now_ns):
                self._open_again(now_ns)
            return []
        try:
            packets = self._link.receive(self._port.read(SERIAL_CHUNK_BYTES))
            self._write(now_ns)
        except OSError as error:
            self._lose(error, now_ns)
            return []
        return packets

    def send(self, packet: bytes, now_ns: int) -> None:
        """Queue a packet; it is sent until the base station has acknowledged it."""
        if self._link.send(packet) and self._port is not None:
            try:
                self._write(now_ns)
            except OSError as error:
                self._lose(error, now_ns)

    def counters(self) -> dict[str, int]:
        """Counters of the line and the packets."""
        line, link = self._link.line, self._link.counters
        return {
            "bad_crc": line.bad_crc,
            "bad_length": line.bad_length,
            "bad_escape": line.bad_escape,
            "stray_bytes": line.stray_bytes,
            "duplicates": link.duplicates,
            "unknown": link.unknown,
            "resent": link.resent,
            "unsent": link.unsent,
            "reopened": self._reopened,
        }

    def close(self) -> None:
        """Close the line."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> serial.Serial:
        return serial.Serial(self._where, self._baud, timeout=0, write_timeout=0)

    def _open_again(self, now_ns: int) -> None:
        try:
            self._port = self._open()
        except (OSError, ValueError):
            self._backoff.fail(to_seconds(now_ns))
            return
        self.down_reason, self._left = "", b""
        self._reopened += 1
        self._backoff.succeed()

    def _write(self, now_ns: int) -> None:
        assert self._port is not None
        self._left += self._link.to_write(now_ns)
        if self._left:
            self._left = self._left[write_at_once(self._port, self._left) :]


class SimulatedAirLink(PacketLink):
    """A robot's place in the simulated air; it ends with the endpoint.

    Args:
        env: the plugin's environment.
        capacity: packets that may wait for the next step.

    """

    def __init__(self, env: Environment, capacity: int, backoff: Backoff) -> None:
        super().__init__("the simulated air", backoff)
        self._inbox = Inbox(capacity)
        env.wake_on(self._inbox)
        self._publisher = env.wire.publisher(ARENA_RADIO_TX, robot=env.robot)
        env.wire.subscribe(self._inbox, ARENA_RADIO_RX, robot=env.robot)

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step."""
        self.dropped = self._inbox.dropped
        return [packet for _, _, packet in self._inbox.drain_raw()] if self._inbox.has_some else []

    def send(self, packet: bytes, now_ns: int) -> None:
        """Put a packet on the air."""
        self._publisher.put_bytes(packet)


CHUNK_BYTES = 65_536
MAX_UNSENT_BYTES = 4096
"""About a hundred packets; further ones are not sent while these wait."""


class SfLink(PacketLink):
    """A client of a Serial Forwarder.

    Args:
        wanted: where it listens, how many packets are taken in a step, and how long the first greeting may take.
        backoff: when to connect again.

    Raises:
        OSError: no server listens there, or none greets in time.
        BadGreeting: it is no Serial Forwarder.

    """

    def __init__(self, wanted: "MoteBase.Parameters", backoff: Backoff) -> None:
        super().__init__(f"{wanted.host}:{wanted.port}", backoff)
        self._unsent = self._reconnects = 0
        self._capacity = wanted.inbox_packets
        self._to_send = b""
        self._decoder = PacketDecoder()
        self._early: list[bytes] = []
        address, timeout_s = (wanted.host, wanted.port), wanted.connect_timeout_s
        self._socket: socket.socket | None = socket.create_connection(address, timeout=timeout_s)
        try:
            self._address = self._socket.getpeername()
            self._family = self._socket.family
            self._socket.sendall(GREETING)
            while not self._decoder.has_greeted:
                data = self._socket.recv(CHUNK_BYTES)
                if not data:
                    raise ConnectionError("it hung up before it greeted")
                self._early += self._decoder.feed(data)
            self._socket.setblocking(False)
        except BaseException:
            self._socket.close()
            raise

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step; the call also tries to reopen a lost connection when it is due."""
        if self._socket is None:
            if self._is_due(now_ns):
                self._connect(now_ns)
            return []
        packets = deque(self._early, maxlen=self._capacity)
        self._early = []
        try:
            self._flush()
            # At most as much as the inbox holds: an endless forwarder must not block the step.
            for _ in range(1 + self._capacity * 64 // CHUNK_BYTES):
                data = self._socket.recv(CHUNK_BYTES)
                if not data:
                    raise ConnectionError("the Serial Forwarder hung up")
                came = self._decoder.feed(data)
                self.dropped += max(0, len(packets) + len(came) - self._capacity)
                packets += came
        except BlockingIOError:
            pass
        except (OSError, BadGreeting) as error:
            self._lose(error, now_ns)
        if self.down_reason and self._socket is not None:
            if self._decoder.has_greeted:
                self.down_reason = ""
                self._reconnects += 1
                self._backoff.succeed()
            elif self._is_due(now_ns):
                self._lose("nobody greets", now_ns)
        return list(packets)

    def send(self, packet: bytes, now_ns: int) -> None:
        """Send a packet to the forwarder; without a connection it is counted as not sent."""
        if self._socket is None or self.down_reason or len(self._to_send) > MAX_UNSENT_BYTES:
            self._unsent += 1
            return
        self._to_send += encode(packet)
        try:
            self._flush()
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(error, now_ns)

    def counters(self) -> dict[str, int]:
        """Packets that could not be sent, and connections after the first."""
        return {"unsent": self._unsent, "reconnects": self._reconnects}

    def close(self) -> None:
        """Close the connection."""
        self._to_send = b""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self, now_ns: int) -> None:
        """Begin a connection; its success shows at the next transfer."""
        self._backoff.fail(to_seconds(now_ns))  # until the forwarder has greeted
        self._decoder = PacketDecoder()
        self._to_send = GREETING
        self._socket = socket.socket(self._family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.connect_ex(self._address)

    def _flush(self) -> None:
        assert self._socket is not None
        while self._to_send:
            self._to_send = self._to_send[self._socket.send(self._to_send) :]


POLL_S = 0.05
"""Period of the step with a line that does not signal arrivals."""
CHECK_S = 0.25
"""Period with a line that signals arrivals."""


class FloodGuard:
    """Limits the number of packets in each second, and reports whether there were more.

    Args:
        limit: packets in a second.

    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.since_ns: int | None = None
        """When the flood began; None while there is none."""
        self._second_ns = 0
        self._count = 0

    def admit(self, arrived: int, now_ns: int) -> int:
        """Number of arrived packets that are passed on.

        A flood ends with the first second that keeps the limit.
        """
        if now_ns - self._second_ns >= NS_PER_S:
            if self._count <= self.limit:
                self.since_ns = None
            self._second_ns, self._count = now_ns, 0
        room = max(0, self.limit - self._count)
        self._count += arrived
        if self._count > self.limit and self.since_ns is None:
            self.since_ns = now_ns
        return min(arrived, room)


class PacketCounters(msgspec.Struct, frozen=True):
    """Counters of the base station's received and sent packets."""

    packets: int
    malformed: int
    dropped: int
    """Packets that came while too many waited already."""
    muted: int
    """Packets ignored because there were too many in a second."""
    floods: int
    sent: int
    flooding: bool
    down_reason: str
    line: dict[str, int]
    """Additional counters of the kind of line."""


class LineHealth(msgspec.Struct, frozen=True):
    """State of the line to the base station."""

    is_up: bool
    down_reason: str
    down_s: float
    """Time since which it is lost; 0 while it is open."""
    tries: int
    """Attempts to reopen it."""
    next_try_s: float
    """Time until the next attempt; 0 while the line is open."""


class MoteBase(Device):
    """Passes on each packet that the radio receives, and sends packets.

    A flood or a lost line is reported to the team by `trouble`. The robot accepts the number of packets a second that
    the manifest allows, and tries to open a lost line again. A flood that does not end is a fault. So is a line that is
    not there at the start: as with any fault, the host starts the plugin again, less and less often.
    """

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The line, and limits of its traffic.

        Raises ValueError if a value makes no sense.
        """

        interface: Literal["zenoh", "sf", "serial"] = "zenoh"
        host: str = "127.0.0.1"
        port: PositiveInt = DEFAULT_PORT
        device: str = "/dev/ttyUSB0"
        baud: PositiveInt = 57_600
        address: Annotated[int, Meta(ge=0, le=65_534)] = 0
        """Address of the base station on the air, the source of the robot's packets."""
        inbox_packets: PositiveInt = 256
        flood_packets_s: PositiveInt = 200
        flood_fault_s: NotNegative = 5.0
        ack_timeout_s: Positive = 0.3
        resends: NotNegativeInt = 3
        connect_timeout_s: Positive = 2.0
        reconnect_first_s: Positive = 0.5
        reconnect_longest_s: float = 10.0

        def __post_init__(self) -> None:
            super().__post_init__()
            if not self.reconnect_longest_s >= self.reconnect_first_s:
                raise ValueError(f"expected reconnect_longest_s >= reconnect_first_s, got {self.reconnect_longest_s}")

    interface = MoteBaseInterface
    period_s = POLL_S
    received = Event[ReceivedPacket]()
    trouble = Event[Trouble](outside=True)
    parameters: Parameters

    def init(self) -> None:
        self._link: PacketLink | None = None
        self._guard = FloodGuard(self.parameters.flood_packets_s)
        self._packets = self._malformed = self._muted = self._floods = self._sent = 0
        self._dropped_before = 0
        self._reported_down = ""
        self._reported_flood = False
        self._backoff = Backoff(self.parameters.reconnect_first_s, self.parameters.reconnect_longest_s)
        self._down_ns = 0

    def activate(self) -> None:
        self._link = self._open_link()
        self.period_s = CHECK_S if self.parameters.interface == "zenoh" else POLL_S
        self._dropped_before = 0

    def step(self) -> None:
        if self._link is None:
            return
        now_ns = self.env.clock.now_ns()
        packets = self._link.receive(now_ns)
        if packets or self._guard.since_ns is not None:
            self._handle(packets, self._link.dropped, now_ns)
        self._report_line(self._link.down_reason, now_ns)

    def deactivate(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def send(self, destination: int, kind: int, payload: bytes) -> None:
        """Send one packet on the air (BadPacket if it is invalid); its reception is unknown."""
        message = ActiveMessage(
            type=kind, payload=payload, source=self.parameters.address, destination=destination
        )  # fmt: skip
        packet = message.pack()
        if self._link is not None:
            self._link.send(packet, self.env.clock.now_ns())
            self._sent += 1

    @external
    def counters(self) -> PacketCounters:
        """Packets received and sent, and reasons for those that were not passed on."""
        link = self._link
        return PacketCounters(
            packets=self._packets,
            malformed=self._malformed,
            dropped=link.dropped if link is not None else 0,
            muted=self._muted,
            floods=self._floods,
            sent=self._sent,
            flooding=self._guard.since_ns is not None,
            down_reason=link.down_reason if link is not None else "",
            line=link.counters() if link is not None else {},
        )

    @external
    def health(self) -> LineHealth:
        """State of the connection; if it is lost, since when, and the time of the next attempt."""
        if not self._reported_down:
            return LineHealth(is_up=True, down_reason="", down_s=0.0, tries=0, next_try_s=0.0)
        now_ns = self.env.clock.now_ns()
        return LineHealth(
            is_up=False,
            down_reason=(self._link.down_reason if self._link is not None else "") or self._reported_down,
            down_s=(now_ns - self._down_ns) / NS_PER_S,
            tries=self._backoff.failures,
            next_try_s=self._backoff.wait_s(to_seconds(now_ns)),
        )

    def _handle(self, packets: list[bytes], dropped: int, now_ns: int) -> None:
        arrived = len(packets) + dropped - self._dropped_before
        self._dropped_before = dropped
        admitted = min(self._guard.admit(arrived, now_ns), len(packets))
        self._muted += len(packets) - admitted
        self._report_flood(arrived, now_ns)
        for packet in packets[:admitted]:
            try:
                message = ActiveMessage.unpack(packet)
            except BadPacket:
                self._malformed += 1
                continue
            self._packets += 1
            self.received.notify(ReceivedPacket(message, now_ns))

    def _report_flood(self, arrived: int, now_ns: int) -> None:
        since_ns = self._guard.since_ns
        if since_ns is None:
            if self._reported_flood:
                self._reported_flood = False
                self.trouble.notify(Trouble("flood_over", f"{self.env.plugin} is quiet again"))
            return
        limit = self._guard.limit
        if not self._reported_flood:
            self._reported_flood = True
            self._floods += 1
            reason = f"{self.env.plugin} floods: more than {limit} packets in a second, {arrived} of them at once"
            self.trouble.notify(Trouble("flood", reason))
        fault_s = self.parameters.flood_fault_s
        if fault_s > 0 and now_ns - since_ns >= to_ns(fault_s):
            lasted_s = (now_ns - since_ns) / NS_PER_S
            reason = f"{self.env.plugin} has flooded for {lasted_s:.0f} s: more than {limit} packets in a second"
            raise PluginError(self.env.plugin, reason)

    def _report_line(self, down_reason: str, now_ns: int) -> None:
        if bool(down_reason) != bool(self._reported_down):
            self._reported_down, self._down_ns = down_reason, now_ns
            self.trouble.notify(Trouble("lost", down_reason) if down_reason else Trouble("back", "the line is back"))

    def _open_link(self) -> PacketLink:
        wanted, backoff = self.parameters, self._backoff
        if wanted.interface == "zenoh":
            return SimulatedAirLink(self.env, wanted.inbox_packets, backoff)
        is_serial = wanted.interface == "serial"
        what = f"base station at {wanted.device}" if is_serial else f"Serial Forwarder at {wanted.host}:{wanted.port}"
        try:
            return SerialLineLink(wanted, backoff) if is_serial else SfLink(wanted, backoff)
        except (OSError, BadGreeting) as error:
            raise LineAbsent(f"no {what}: {error}") from error
        except ValueError as error:  # a line that is never as fast as that
            raise HardwareAbsent(self.env.plugin, f"no {what}: {error}") from error
