"""Errors of `robrain assistant`.

RobrainError
├── AuditError                the audit log cannot be written
└── Refused                   a call that is not carried out; carries its `.ban`
"""

from pathlib import Path

from robrain.deploy.assistant.policy import Ban
from robrain.deploy.assistant.words import refusal
from robrain.protocol.errors import RobrainError


class AuditError(RobrainError):
    """The audit log cannot be written."""

    def __init__(self, path: Path, error: OSError) -> None:
        super().__init__(f"{path}: the audit log cannot be written: {error.strerror or error}")


class CallRefused(RobrainError):
    """A call that is not carried out.

    Args:
        ban: why.
        detail: what it is about, in words.

    """

    def __init__(self, ban: Ban, detail: str = "") -> None:
        super().__init__(refusal(ban, detail))
        self.ban = ban
