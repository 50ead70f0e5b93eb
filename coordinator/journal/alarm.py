"""Alarms: the sources for which a rule has made a task, as the journal stores them."""

from typing import NamedTuple


class Alarm(NamedTuple):
    """Outcome of one source of a rule when it last made a task."""

    rule: str
    source: str
    """The mote, or the robot of an event; empty if the rule is one for the whole team."""
    measured_ns: int
    """When the reading was taken, or the event happened, for which the task was made."""
    fired_ns: int
    """When it was made."""
    is_armed: bool = False
    """Whether the source has been clear since, so that it may make another one."""
