"""Errors of a client, besides those that a team replies.

RobrainError
└── BadTask                   an invalid task: unknown kind, or a field that is missing or invalid
"""

from robrain.protocol.errors import RobrainError


class BadTask(RobrainError):
    """An invalid task; the text names the field and the expected value."""
