"""A client's connection to a team: a session, and how time passes."""

from pathlib import Path
from typing import Protocol

import zenoh

from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Drive


class Transport(Protocol):
    """Reaches one team. `LiveTransport` and `LockstepTransport` satisfy it."""

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session of the client."""

    @property
    def team(self) -> str:
        """Name of the team."""

    @property
    def clock(self) -> Clock:
        """The clock that stamps messages."""

    @property
    def drive(self) -> Drive:
        """Whether time is real or virtual."""

    @property
    def patience_s(self) -> float:
        """How long queries to an absent coordinator are repeated; 0 where it cannot be absent."""

    @property
    def gather_s(self) -> float:
        """How long to wait for robots to be discovered; 0 where all are known at once."""

    def elapsed_s(self) -> float:
        """Seconds since the client began; never goes back."""

    def pass_time(self, seconds: float) -> None:
        """Let that much time pass; in lockstep a whole number of ticks, at least one."""

    def open_folder(self, robot: str, folder: Path) -> None:
        """Let a robot that runs in this process load plugins from a folder; others have that in their own file."""

    def close(self) -> None:
        """Leave the team; in lockstep, end the run. May be called again."""
