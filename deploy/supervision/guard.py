"""Ends the remaining processes when `robrain up` is killed: a separate process, with the standard library alone.

Run as a script. It reads lines from standard input: `+123` for a process group that was started, `-123` for one that
has ended. At the end of the input it gives the groups a moment to end, as their processes notice that their parent has
gone. It then kills the remaining processes, including stopped ones and those that the groups have started.
"""

import os
import signal
import sys
import time
from collections.abc import Iterable
from contextlib import suppress

GRACE_S = 3.0
CHECK_S = 0.05


def groups_left(lines: Iterable[str]) -> set[int]:
    """The groups that were started and have not ended.

    >>> groups_left(["+12", "+13", "-12", "?"])
    {13}
    """
    groups: set[int] = set()
    for line in lines:
        sign, number = line[:1], line[1:].strip()
        if number.isdigit() and int(number) > 1:
            if sign == "+":
                groups.add(int(number))
            elif sign == "-":
                groups.discard(int(number))
    return groups


def is_there(group: int) -> bool:
    """Whether a process group has a process."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def end_groups(groups: set[int], grace_s: float = GRACE_S) -> None:
    """Wait for the ends of groups, and kill the remaining ones."""
    until_s = time.monotonic() + grace_s
    while groups and time.monotonic() < until_s:
        groups = {group for group in groups if is_there(group)}
        time.sleep(CHECK_S)
    for group in groups:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(group, signal.SIGKILL)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    end_groups(groups_left(sys.stdin))
