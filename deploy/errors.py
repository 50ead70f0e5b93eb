"""Errors of the command line.

RobrainError
├── UsageError                the command line is wrong
├── ChildFailed               a process of the team did not start; carries its output
├── LogError                  a lidar log or a file of relations cannot be read, or is invalid
├── SweepError                the folder of a sweep cannot be used, or holds another sweep
└── InstanceError             a public routing instance cannot be read, or does not fit the allocators' model
"""

from robrain.protocol.errors import RobrainError


class UsageError(RobrainError):
    """The command line is wrong; the text names the option and the expected value."""


class ChildFailed(RobrainError):
    """A process of the team did not start."""


class InstanceError(RobrainError):
    """A public routing instance cannot be read or solved; the text names the file and the expected value."""


class LogError(RobrainError):
    """A lidar log, or a file of relations, cannot be read or played; the text names file and line."""


class SweepError(RobrainError):
    """The folder of a sweep cannot be read or written, or holds another sweep; the text names it and the difference."""
