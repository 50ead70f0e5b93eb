"""What a wrapped program offers."""

from enum import StrEnum
from typing import Protocol

import msgspec

from robrain.agent.event import Event


class Running(StrEnum):
    """Whether a program runs."""

    RUNNING = "running"
    WAITING = "waiting"
    """It has failed and will be started again."""
    ENDED = "ended"


class ProgramState(msgspec.Struct, frozen=True, kw_only=True):
    """How a program stands."""

    running: Running
    pid: int | None = None
    restarts: int = 0
    """Restarts since it last ran for a while."""
    lines: int = 0
    """Lines that it has said."""
    lines_left_out: int = 0
    """Lines that were too long, or no JSON where JSON was expected."""
    why: str = ""
    """How it ended last."""


class ProgramInterface(Protocol):
    """Lines in, lines out."""

    said: Event[str]
    """Each line of the program's standard output, also those that answer a `send`."""

    def send(self, text: str) -> str:
        """Give the program one line and return the next one that it says."""

    def tell(self, text: str) -> None:
        """Give the program one line; whatever it says comes as `said`."""

    def state(self) -> ProgramState:
        """How the program stands."""
