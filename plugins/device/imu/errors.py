"""Faults of inertial measurement units, like others: the plugin is started again later.

ImuAbsent(OSError)   the unit is not there, or silent
ImuContradicted      it and the wheels contradict each other
"""


class ImuAbsent(OSError):
    """The unit is not there, or says nothing."""


class ImuContradicted(Exception):
    """The unit is mounted or read wrongly; until it agrees the wheels' turning counts."""
