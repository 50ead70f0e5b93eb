"""python-can's interface `zenoh`: a CAN bus of a simulated robot, carried under `arena/{robot}/can/{channel}`.

It is registered as an entry point, so `python -m can.viewer -i zenoh -c r1/can0` works on a simulated robot.
"""

import os
import struct
import threading
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any

import can
import zenoh

from robrain.protocol.wire.errors import BadName, WireError
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topic import CAN_FRAME
from robrain.protocol.wire.topics import ARENA_CAN

QUEUE_FRAMES = 4096
REMEMBERED_IDENTIFIERS = 4096

_HEADER = struct.Struct("<QqI")
"""Sender, stamp in ns, identifier with the flags of SocketCAN in its three top bits."""
_EXTENDED, _REMOTE, _ERROR = 1 << 31, 1 << 30, 1 << 29
_ID_MASK = (1 << 29) - 1

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
        verdict = not self._chosen or bool(identifier & _ERROR) or matches
        if len(self) < REMEMBERED_IDENTIFIERS:
            self[traveling] = verdict
        return verdict


class ZenohBus(can.BusABC):
    """One node on a bus.

    Args:
        channel: `ROBOT/CHANNEL`, such as `r1/can0`.
        can_filters: as in python-can.
        session: a session to share; without one the bus opens its own.
        team: whose robot it is.
        connect: endpoint for a session of its own; default is the environment's ROBRAIN_CONNECT.
        direct: deliver in the sender's thread (lockstep).
        now_ns: stamps what is sent; 0 without it.
        on_outside: with `direct`, told of frames (key, payload) that come from another process.

    Raises:
        can.CanInitializationError: the channel is not `ROBOT/CHANNEL`, or nobody answers at the endpoint.

    """

    def __init__(
        self,
        channel: Any,
        can_filters: can.typechecking.CanFilters | None = None,
        *,
        session: zenoh.Session | None = None,
        team: str = DEFAULT_TEAM,
        connect: str | None = None,
        direct: bool = False,
        now_ns: Callable[[], int] | None = None,
        on_outside: Callable[[str, bytes], None] | None = None,
        **_ignored: object,  # python-can's tools hand every interface their own options (bitrate, fd, …)
    ) -> None:
        robot, slash, bus = str(channel).partition("/")
        if not slash:
            raise can.CanInitializationError(f"channel {channel!r}: expected ROBOT/CHANNEL, such as r1/can0")
        try:
            key = ARENA_CAN.key(team, robot=robot, channel=bus)
        except BadName as error:
            raise can.CanInitializationError(f"channel {channel!r}: {error}") from error
        self.channel_info = f"zenoh {channel}"
        self._channel = str(channel)
        """As frames bear it: candump's format has no room for blanks in it."""
        self.dropped = 0
        self._now_ns = now_ns
        self._direct = direct
        self._on_outside = on_outside
        self._owner = threading.get_ident()
        self._frames: deque[bytes] = deque(maxlen=QUEUE_FRAMES)
        self._arrived = threading.Condition()
        self._filter = _Filter([])
        self._own_session: zenoh.Session | None = None
        if session is None:
            endpoint = connect or os.environ.get("ROBRAIN_CONNECT", "")
            try:
                session = self._own_session = open_session(connect=[endpoint] if endpoint else [])
            except WireError as error:
                raise can.CanInitializationError(str(error)) from error
        self._apply_filters(can_filters)  # before the first frame can arrive
        self._node = (int(str(session.zid())[:12], 16) << 16) | (next(_bus_number) & 0xFFFF)
        self._node_bytes = self._node.to_bytes(8, "little")
        self._publisher = session.declare_publisher(
            key,
            encoding=CAN_FRAME,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
        self._subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(self._take, indirect=not direct))
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus; every other node of the bus receives it.

        Raises:
            can.CanOperationError: it is a CAN FD frame; the bus carries classic ones.

        """
        if msg.is_fd:
            raise can.CanOperationError(f"{self.channel_info}: carries classic CAN frames, not CAN FD")
        identifier = msg.arbitration_id
        if msg.is_extended_id:
            identifier |= _EXTENDED
        if msg.is_remote_frame:
            identifier |= _REMOTE
        if msg.is_error_frame:
            identifier |= _ERROR
        stamp_ns = self._now_ns() if self._now_ns is not None else 0
        # A remote frame asks for so many bytes and brings none: they stand for its length.
        data = bytes(msg.dlc) if msg.is_remote_frame else msg.data
        self._publisher.put(_HEADER.pack(self._node, stamp_ns, identifier) + data)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None if none comes in time; with 0 it only looks, as devices do many times a tick."""
        if timeout != 0:
            return super().recv(timeout)
        try:
            return self._unpack(self._frames.popleft())
        except IndexError:
            return None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._frames:
            with self._arrived:
                self._arrived.wait_for(lambda: bool(self._frames), timeout)
        # Filtered as they arrive: python-can's own filter ends a recv(timeout=0) at the first frame that it leaves out.
        return (self._unpack(self._frames.popleft()), True) if self._frames else (None, True)

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        """As SocketCAN: a filter without `extended` takes both kinds; error frames always come through."""
        chosen = []
        for each in filters or ():
            value, mask = each["can_id"] & _ID_MASK, each["can_mask"] & _ID_MASK
            if "extended" in each:
                mask |= _EXTENDED
                value |= _EXTENDED if each["extended"] else 0
            chosen.append((value & mask, mask))
        self._filter = _Filter(chosen)  # in one go: frames may be arriving

    def _unpack(self, payload: bytes) -> can.Message:
        _, stamp_ns, identifier = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size :]
        return can.Message(
            timestamp=stamp_ns / 1e9,
            arbitration_id=identifier & _ID_MASK,
            is_extended_id=bool(identifier & _EXTENDED),
            is_remote_frame=bool(identifier & _REMOTE),
            is_error_frame=bool(identifier & _ERROR),
            dlc=len(data),
            data=None if identifier & _REMOTE else data,
            channel=self._channel,
        )

    def shutdown(self) -> None:
        """Leave the bus."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._subscriber.undeclare()
        self._publisher.undeclare()
        if self._own_session is not None:
            self._own_session.close()

    def _take(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if len(payload) < _HEADER.size or payload[:8] == self._node_bytes:
            return
        if not self._filter[payload[16:20]]:
            return
        self.dropped += len(self._frames) == QUEUE_FRAMES
        self._frames.append(payload)
        if not self._direct:
            with self._arrived:
                self._arrived.notify_all()
        elif self._on_outside is not None and threading.get_ident() != self._owner:
            self._on_outside(str(sample.key_expr), payload[_HEADER.size :])
