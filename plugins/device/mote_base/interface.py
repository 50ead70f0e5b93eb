"""Interface of the base station."""

from typing import Literal, Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.tinyos.packet import ActiveMessage


class ReceivedPacket(msgspec.Struct, frozen=True):
    """A packet that the radio has received."""

    message: ActiveMessage
    stamp_ns: int
    """Time at which it was read from the line, by the robot's clock."""


class Trouble(msgspec.Struct, frozen=True):
    """A fault of the base station has begun or ended."""

    kind: Literal["flood", "flood_over", "lost", "back"]
    """It sends more than the robot accepts; its line is lost; and the ends of both."""
    why: str


class MoteBaseInterface(Protocol):
    """TinyOS active messages, received and sent."""

    received: Event[ReceivedPacket]
    trouble: Event[Trouble]

    def send(self, destination: int, kind: int, payload: bytes) -> None: ...
