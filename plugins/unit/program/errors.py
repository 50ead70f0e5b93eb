"""What can go wrong with a wrapped program.

PluginError
├── HardwareAbsent
│   └── ProgramAbsent     there is no such executable
├── BadLine               that cannot be given to the program
├── ProgramEnded          it does not run
└── ProgramLate           it did not answer in time, and was killed
"""

from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.protocol.wire.errors import ErrorCode


class ProgramAbsent(HardwareAbsent):
    """There is no such executable; the plugin is left out as if its hardware were absent."""


class BadLine(PluginError):
    """That cannot be given to the program."""

    code = ErrorCode.BAD_ARGUMENTS


class ProgramEnded(PluginError):
    """The program does not run."""

    code = ErrorCode.INACTIVE


class ProgramLate(PluginError):
    """The program did not answer in time, and was killed."""

    code = ErrorCode.TIMEOUT
