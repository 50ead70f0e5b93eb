"""Errors of the stand-in.

RobrainError
└── ScriptError   a fault script's file is not one
"""

from robrain.protocol.wire.errors import RobrainError


class ScriptError(RobrainError):
    """A file is no fault script; the text names file and key."""
