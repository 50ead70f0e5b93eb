"""What can go wrong when a team is asked for something, beyond what it answers.

RobrainError
└── BadTask                   a task that cannot be asked for: no such kind, or a field that is missing or invalid
"""

from robrain.protocol.wire.errors import RobrainError


class BadTask(RobrainError):
    """A task that cannot be asked for; the text names the field and what was expected."""
