"""Errors of the command line."""

from robrain.protocol.errors import RobrainError


class UsageError(RobrainError):
    """The command line is wrong; the text names the option and the expected value."""


class ChildFailed(RobrainError):
    """A process of the team did not start."""


class PkiError(RobrainError):
    """A certificate, or a file of them, cannot be made or used."""


class InstanceError(RobrainError):
    """A public routing instance cannot be read or solved; the text names the file and the expected value."""


class LogError(RobrainError):
    """A lidar log, or a file of relations, cannot be read or played; the text names file and line."""


class SweepError(RobrainError):
    """The folder of a sweep cannot be read or written, or holds another sweep; the text names it and the difference."""
