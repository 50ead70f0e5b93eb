"""python-can's interface `zenoh`: a CAN bus of a simulated robot, carried under `arena/{robot}/can/{channel}`.

It is registered as an entry point, so `python -m can.viewer -i zenoh -c r1/can0` works on a simulated robot.
"""

import threading
from collections import deque
from collections.abc import Callable, Sized
from contextlib import suppress
from itertools import count
from threading import get_ident
from typing import Any, ClassVar
from weakref import WeakValueDictionary

import can
import zenoh

from robrain.protocol.can.frame_port import Frame
from robrain.protocol.can.payload import (
    CLASSIC_BYTES,
    CLASSIC_DATA_BYTES,
    ERROR,
    EXTENDED,
    HEADER,
    HEADER_BYTES,
    ID_MASK,
    IDENTIFIER,
    NO_STAMP,
    NODE,
    STAMP,
    data_in,
    flagged_identifier,
    is_fd,
    pack_fd,
    unpack,
)
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import BadName, WireError
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.link import Declaration
from robrain.protocol.links.receivers import NOBODY
from robrain.protocol.messages.team.arena_messages import ARENA_CAN
from robrain.protocol.topic import CAN_FRAME
from robrain.protocol.wire.hub import team_endpoints
from robrain.protocol.wire.session import open_session

ROUTES_MAX = 4096
"""Identifiers and senders whose receivers are cached."""


class Segment:
    """The nodes of one bus of one session."""

    _of_key: ClassVar["WeakValueDictionary[tuple[str, str], Segment]"] = WeakValueDictionary()

    def __init__(self) -> None:
        self.owner = get_ident()
        self._nodes: list[ZenohBus] = []
        self.routes: dict[tuple[bytes, int], list[ZenohBus]] = {}

    @classmethod
    def of(cls, session: str, key: str) -> "Segment":
        """The one segment of a key and a session, by its id; it goes with its last node."""
        found = cls._of_key.get((session, key))
        if found is None:
            found = cls._of_key[session, key] = cls()
        return found

    def join(self, node: "ZenohBus") -> None:
        """Have a node receive from now on."""
        self._nodes.append(node)
        self.routes.clear()

    def leave(self, node: "ZenohBus") -> None:
        """Have it receive no more."""
        if node in self._nodes:
            self._nodes.remove(node)
        self.routes.clear()

    def find_route(self, identifier: bytes, sender: "ZenohBus") -> list["ZenohBus"]:
        """The nodes that want frames with an identifier from a sender."""
        if len(self.routes) >= ROUTES_MAX:
            self.routes.clear()
        route = [node for node in self._nodes if node.wants(identifier, sender)]
        self.routes[identifier, id(sender)] = route
        return route


QUEUE_FRAMES = 4096
REMEMBERED_IDENTIFIERS = 4096
MEET_TIMEOUT_S = 2.0
"""Time limit, when a bus is opened, for the answers of other nodes: the process of one may hang."""
PERIODIC_END_S = 2.0
"""How long a thread of periodic frames may take to end."""
WITHOUT_MEANING = frozenset({"bitrate", "data_bitrate", "single_handle", "timing"})
"""Options that python-can's tools pass to every interface and that mean nothing on a bus without a physical layer."""

_bus_number = count(1)


class _Filter(dict[bytes, bool]):
    """Whether frames with an identifier, as it travels, are to be received; found out once for each.

    Args:
        chosen: value and mask of the identifiers to be received; all if there are none.

    """

    def __init__(self, chosen: list[tuple[int, int]]) -> None:
        super().__init__()
        self._chosen = chosen

    def __missing__(self, traveling: bytes) -> bool:
        identifier = int.from_bytes(traveling, "little")
        matches = any(identifier & mask == value for value, mask in self._chosen)
        verdict = not self._chosen or bool(identifier & ERROR) or matches
        if len(self) < REMEMBERED_IDENTIFIERS:
            self[traveling] = verdict
        return verdict


class ZenohBus(can.BusABC):
    """One node on a bus.

    The constructor returns once this node and all nodes already on the bus have found each other. The first frame in
    either direction then arrives. For this each node answers queries on the bus's key.

    The time stamp of a frame is the time of sending if the sender has a clock, else the time of reception.

    Args:
        channel: `ROBOT/CHANNEL`, such as `r1/can0`.
        can_filters: as in python-can.
        session: a session to share; without one the bus opens its own.
        team: robot that it belongs to.
        connect: endpoint for a separate session; default is $ROBRAIN_CONNECT, else this machine's hub.
        fd: send and receive CAN FD frames as well; without it they are refused.
        receive_own_messages: also receive the frames this node sends, with `is_rx` false.
        direct: deliver in the sender's thread (lockstep).
        now_ns: clock that stamps the frames sent. Without one, frames that arrive unstamped get the time of day, or no
            stamp in lockstep.
        on_outside: with `direct`, called with (key, payload) for frames from another process.
        others: `bitrate`, `data_bitrate`, `timing` and `single_handle` are accepted and ignored.

    Raises:
        can.CanInitializationError: the channel is not `ROBOT/CHANNEL`, an option is wrong or unknown, or nothing
            answers at the endpoint.

    """

    wakes = True

    def __init__(
        self,
        channel: Any,
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        session: zenoh.Session | None = None,
        team: str = DEFAULT_TEAM,
        connect: str | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
        direct: bool = False,
        now_ns: Callable[[], int] | None = None,
        on_outside: Callable[[str, bytes], None] | None = None,
        **others: object,
    ) -> None:
        _check_options(
            others, {"team": team, "connect": connect}, {"fd": fd, "receive_own_messages": receive_own_messages}
        )
        robot, slash, bus = str(channel).partition("/")
        if not slash:
            raise can.CanInitializationError(f"channel {channel!r}: expected ROBOT/CHANNEL, such as r1/can0")
        try:
            self._key = ARENA_CAN.key(team, robot=robot, channel=bus)
        except BadName as error:
            raise can.CanInitializationError(f"channel {channel!r}: {error}") from error
        self.channel_info = f"zenoh {channel}"
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._channel = str(channel)
        """Channel set in received frames; candump's format allows no blanks in it."""
        self.dropped = 0
        """Frames lost because they were not received in time."""
        self.refused = 0
        """Payloads that are not a valid frame, or not one this bus accepts."""
        self._fd = fd
        self._receives_own = receive_own_messages
        self._now_ns = now_ns
        self._received_ns = now_ns or (None if direct else LiveClock().now_ns)
        self._direct = direct
        self._on_outside = on_outside
        self._owner = threading.get_ident()
        self.frames: deque[bytes] = deque(maxlen=QUEUE_FRAMES)
        self.pending: Sized = self.frames
        self.on_frame: Callable[[], None] | None = None
        self._arrived = threading.Condition()
        self._segment: Segment | None = None
        self._filter = _Filter([])
        self._apply_filters(can_filters)  # before the first frame can arrive
        self._own_session: zenoh.Session | None = None
        if session is None:
            try:
                session = self._own_session = open_session(connect=team_endpoints(connect or None))
            except WireError as error:
                raise can.CanInitializationError(str(error)) from error
        self._session = session
        self._node = (int(str(session.zid())[:12], 16) << 16) | (next(_bus_number) & 0xFFFF)
        self._node_bytes = self._node.to_bytes(8, "little")
        self._sending = threading.Lock()
        self._segment = Segment.of(str(session.zid()), self._key) if direct else None
        self._exchange = Exchange.of(session) if direct else None
        self._publisher: zenoh.Publisher | None = None
        self._declared: list[Declaration] = []
        if self._exchange is None or not self._exchange.is_alone:
            self._declare(session)
        if self._segment is not None:
            self._segment.join(self)
        else:
            self._meet()
        super().__init__(channel=channel, can_filters=can_filters)

    def _declare(self, session: zenoh.Session) -> None:
        """Declare the node to other processes: publisher, subscription and queryable."""
        congestion = zenoh.CongestionControl
        self._publisher = session.declare_publisher(
            self._key,
            encoding=CAN_FRAME,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            # With a separate session (a tool), sending waits while the network is congested, as at a full transmit
            # queue. In a shared session that would make all other users wait too, so frames are dropped.
            congestion_control=congestion.BLOCK if self._own_session is not None else congestion.DROP,
            express=True,
            # Nodes of a lockstep run exchange frames without Zenoh.
            allowed_destination=zenoh.Locality.REMOTE if self._direct else zenoh.Locality.ANY,
        )
        # Direct in live as well: neither call blocks or needs a separate thread.
        receive = zenoh.handlers.Callback(self._receive, indirect=False)
        answer = zenoh.handlers.Callback(self._answer, indirect=False)
        subscriber = session.declare_subscriber(self._key, receive)
        self._declared = [self._publisher, subscriber, session.declare_queryable(self._key, answer)]

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus; every other node of the bus receives it.

        Raises:
            can.CanOperationError: the bus is shut down or cannot carry this frame.

        """
        if self._is_shutdown:
            raise self._shut_down()
        if not 0 <= msg.arbitration_id <= ID_MASK:
            got = f"{msg.arbitration_id:#x}"
            raise can.CanOperationError(f"{self.channel_info}: expected an identifier of 29 bits, got {got}")
        identifier = flagged_identifier(msg)
        stamp_ns = self._now_ns() if self._now_ns is not None else 0
        if msg.is_fd:
            payload = self._pack_fd(msg, stamp_ns, identifier)
        else:
            # A remote frame requests `dlc` bytes and carries none; zeros encode that length.
            data = bytes(msg.dlc) if msg.is_remote_frame else msg.data
            payload = HEADER.pack(self._node, stamp_ns, identifier) + data
            if len(payload) > CLASSIC_BYTES:
                raise self._too_long(data)
        self._put(payload)

    def send_data(self, identifier: int, data: bytes) -> None:
        """As `send`, for a classic data frame with an identifier of 11 bits."""
        stamp_ns = self._now_ns() if self._now_ns is not None else 0
        payload = HEADER.pack(self._node, stamp_ns, identifier) + data
        if len(payload) > CLASSIC_BYTES:
            raise self._too_long(data)
        self._put(payload)

    def _put(self, payload: bytes) -> None:
        try:
            with self._sending:
                if self._is_shutdown:
                    raise self._shut_down()
                if self._publisher is not None:
                    self._publisher.put(payload)
        except zenoh.ZError as error:
            raise can.CanOperationError(f"{self.channel_info}: its session is closed") from error
        segment = self._segment
        if segment is not None and self._exchange is not None:
            identifier = payload[IDENTIFIER]
            route = segment.routes.get((identifier, id(self)))
            if route is None:
                route = segment.find_route(identifier, self)
            if len(payload) > CLASSIC_BYTES or payload[STAMP] == NO_STAMP or get_ident() != segment.owner:
                for node in route:
                    node.accept(payload)
            else:
                for node in route:  # as `accept` does with nearly all
                    node.dropped += len(node.frames) == node.frames.maxlen
                    node.frames.append(payload)
                    if node.on_frame is not None:
                        node.on_frame()
            if self._exchange.routes.get(self._key) is not NOBODY:  # only nodes receive most frames
                self._exchange.deliver(self._exchange.infrastructure, ARENA_CAN, self._key, payload)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None if none arrives in time; 0 does not wait, for devices that poll many times a tick.

        Raises:
            can.CanOperationError: the bus is shut down and no frame is left, unless `timeout` is 0.

        """
        if timeout != 0:
            return super().recv(timeout)
        try:
            payload = self.frames.popleft()
        except IndexError:
            return None
        return self._unpack(payload) if self._receives_own else unpack(payload, self._channel)

    def read_frames(self) -> list[Frame]:
        """Take all frames that have arrived, in order."""
        frames, new = self.frames, tuple.__new__
        frames_read: list[Frame] = []
        for _ in range(len(frames)):
            payload = frames.popleft()
            _, stamp_ns, identifier = HEADER.unpack_from(payload)
            data = payload[HEADER_BYTES:] if len(payload) <= CLASSIC_BYTES else data_in(payload)
            frames_read.append(new(Frame, (identifier, data, stamp_ns)))  # as Frame(…), in a third of the time
        return frames_read

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.frames:
            with self._arrived:
                self._arrived.wait_for(lambda: self.frames or self._is_shutdown, timeout)
        # Frames are filtered on arrival: python-can's filter ends a recv(timeout=0) at the first frame it rejects.
        try:
            return self._unpack(self.frames.popleft()), True
        except IndexError:  # none arrived, or another thread took it
            if self._is_shutdown:
                raise self._shut_down() from None
            return None, True

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        """As SocketCAN: a filter without `extended` takes both kinds; error frames always come through."""
        chosen = []
        for each in filters or ():
            try:
                value, mask = each["can_id"] & ID_MASK, each["can_mask"] & ID_MASK
            except (KeyError, TypeError) as error:
                expected = "expected tables with the numbers can_id and can_mask"
                raise can.CanInitializationError(f"{self.channel_info}: can_filters: {expected}, got {each}") from error
            if "extended" in each:
                mask |= EXTENDED
                value |= EXTENDED if each["extended"] else 0
            chosen.append((value & mask, mask))
        self._filter = _Filter(chosen)  # in one go: frames may be arriving
        if self._segment is not None:
            self._segment.routes.clear()  # which depend on its filters

    def shutdown(self) -> None:
        """Leave the bus; threads waiting in `recv` are woken."""
        if self._is_shutdown:
            return
        self.stop_all_periodic_tasks()
        with self._sending:  # a publisher that is in use on another thread cannot be undeclared
            super().shutdown()
        if self._segment is not None:
            self._segment.leave(self)
        with self._arrived:
            self._arrived.notify_all()
        with suppress(zenoh.ZError):  # the session is already closed, which undeclared all of them
            while self._declared:
                self._declared.pop().undeclare()
        if self._own_session is not None:
            self._own_session.close()

    def stop_all_periodic_tasks(self, remove_tasks: bool = True) -> None:
        """Stop periodic frames, and wait for their threads: none of them sends after this."""
        tasks = list(self._periodic_tasks)
        super().stop_all_periodic_tasks(remove_tasks)
        for task in tasks:
            thread = getattr(task, "thread", None)
            if thread is not None and thread is not threading.current_thread():
                thread.join(PERIODIC_END_S)

    def _pack_fd(self, msg: can.Message, stamp_ns: int, identifier: int) -> bytes:
        if not self._fd:
            raise can.CanOperationError(
                f"{self.channel_info}: carries classic CAN frames, not CAN FD: it was opened without fd"
            )
        try:
            return pack_fd(msg, self._node, stamp_ns, identifier)
        except ValueError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error}") from error

    def _unpack(self, payload: bytes) -> can.Message:
        message = unpack(payload, self._channel)
        if payload[NODE] == self._node_bytes:  # only with `receive_own_messages`
            message.is_rx = False
        return message

    def _too_long(self, data: bytes | bytearray) -> can.CanOperationError:
        return can.CanOperationError(
            f"{self.channel_info}: a classic frame has at most {CLASSIC_DATA_BYTES} bytes, got {len(data)}"
        )

    def _shut_down(self) -> can.CanOperationError:
        return can.CanOperationError(f"{self.channel_info}: is shut down")

    def wants(self, traveling: bytes, sender: "ZenohBus") -> bool:
        """Whether the filters accept an identifier, as it travels, and the sender is another or is accepted too."""
        return self._filter[traveling] and (sender is not self or self._receives_own)

    def accept(self, payload: bytes) -> None:
        """Take a frame that `wants` lets through, in lockstep."""
        if len(payload) > CLASSIC_BYTES and not self._fd:
            self.refused += 1
        else:
            self._keep(payload)

    def _receive(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if not HEADER_BYTES <= len(payload) <= CLASSIC_BYTES and not (self._fd and is_fd(payload)):
            self.refused += 1
            return
        if self._filter[payload[IDENTIFIER]] and (payload[NODE] != self._node_bytes or self._receives_own):
            self._keep(payload)

    def _keep(self, payload: bytes) -> None:
        if payload[STAMP] == NO_STAMP and self._received_ns is not None:
            payload = payload[NODE] + self._received_ns().to_bytes(8, "little") + payload[STAMP.stop :]
        frames = self.frames
        if len(frames) == QUEUE_FRAMES:
            self.dropped += 1
        frames.append(payload)
        if not self._direct:
            with self._arrived:
                self._arrived.notify_all()
        elif self._on_outside is not None and threading.get_ident() != self._owner:
            self._on_outside(self._key, payload[HEADER_BYTES:])
        if self.on_frame is not None:
            self.on_frame()

    def _answer(self, query: zenoh.Query) -> None:
        """Report to another node, in its `_meet`, that this one is present."""
        with query:
            query.reply(self._key, b"")

    def _meet(self) -> None:
        """Wait until every other node has this one's subscription, and this one has theirs.

        A session drops frames for which it knows no subscription. Declarations use the same path as the query and
        precede it. A node that has answered therefore has this one's subscription; its own arrived before the answer.
        The wait for a node that hangs ends after `MEET_TIMEOUT_S`.
        """
        replies = self._session.get(
            self._key,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=MEET_TIMEOUT_S,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )
        for _ in replies:
            pass


def _check_options(others: dict[str, object], texts: dict[str, object], switches: dict[str, object]) -> None:
    """Refuse unknown options and values of the wrong type (can.CanInitializationError)."""
    unknown = sorted(others.keys() - WITHOUT_MEANING)
    if unknown:
        known = "team, connect, can_filters, receive_own_messages, fd"
        ignored = ", ".join(sorted(WITHOUT_MEANING))
        raise can.CanInitializationError(
            f"interface zenoh: unknown option {', '.join(unknown)}: expected {known} (ignored: {ignored})"
        )
    for name, value in texts.items():
        if value is not None and not isinstance(value, str):
            raise can.CanInitializationError(f"interface zenoh: option {name}: expected text, got {value!r}")
    for name, value in switches.items():
        if not isinstance(value, bool):
            raise can.CanInitializationError(f"interface zenoh: option {name}: expected true or false, got {value!r}")
