"""Error codes on the wire, and the exceptions of this package.

RobrainError                  everything that robrain raises on purpose
├── BadName                   a robot, mote, team or plugin name that cannot be part of a key
├── BadToml                   a text that is not TOML, too large or nested too deep
├── WireError                 the session could not be opened or used
│   ├── NobodyThere           nothing answers at that endpoint, or nobody of that team is there
│   ├── NameInUse             another process already runs that robot or the coordinator
│   └── PortInUse             another process listens on that port
└── CallError                 a query was answered with an error; carries `.code`
"""

from enum import StrEnum
from typing import Annotated

import msgspec


class ErrorCode(StrEnum):
    """Why a query was answered with an error. The only codes that ever travel."""

    UNKNOWN_PLUGIN = "unknown_plugin"
    UNKNOWN_FUNCTION = "unknown_function"
    BAD_ARGUMENTS = "bad_arguments"
    FORBIDDEN = "forbidden"
    BUSY = "busy"
    HALTED = "halted"
    INACTIVE = "inactive"
    UNLOADED = "unloaded"
    FAILED = "failed"
    REFUSED = "refused"
    TIMEOUT = "timeout"


START_ERRORS = (ErrorCode.UNKNOWN_PLUGIN, ErrorCode.FORBIDDEN, ErrorCode.INACTIVE, ErrorCode.REFUSED)
"""Errors of queries that start or hold a plugin."""
PLUGIN_ERRORS = (*START_ERRORS, ErrorCode.UNKNOWN_FUNCTION, ErrorCode.HALTED)
"""Errors of calls to a plugin."""
ErrorText = Annotated[str, msgspec.Meta(max_length=1_000_000)]


class ErrorReply(msgspec.Struct, frozen=True):
    """Content of an error reply on the wire."""

    code: ErrorCode
    message: ErrorText
    detail: ErrorText = ""


class RobrainError(Exception):
    """Everything that robrain raises on purpose; its text is one sentence for a person."""


class BadName(RobrainError):
    """A name that cannot be part of a key."""

    def __init__(self, what: str, name: str, why: str) -> None:
        super().__init__(f"bad {what} name {name!r}: {why}")
        self.name = name


class BadToml(RobrainError):
    """TOML that cannot be read. The text gives the expected value; the caller adds the file's name."""


class WireError(RobrainError):
    """The session could not be opened or used."""


class NobodyThere(WireError):
    """Nothing answers at an endpoint, or no participant of a team is there."""


class NameInUse(WireError):
    """Another process already runs that robot, or the team's coordinator."""


class PortInUse(WireError):
    """Another process listens on a port that was asked for."""


class CallError(RobrainError):
    """A query was answered with an error, or must be."""

    def __init__(self, code: ErrorCode, message: str, detail: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.detail = detail

    def reply(self) -> ErrorReply:
        """The same, as it travels."""
        return ErrorReply(code=self.code, message=self.message, detail=self.detail)
