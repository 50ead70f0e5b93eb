"""Waits for conditions; the time limit is only for conditions that never hold.

The limit is no statement about speed. It is far above what the slowest loaded machine takes, so that no test fails
because of other work; it still ends a test that hangs.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")

PATIENCE_S = 300.0
"""Longest wait; below pytest's time limit for one test."""


def until(
    condition: Callable[[], T],
    what: str = "it has not come to pass",
    *,
    step: Callable[[], object] = lambda: None,
    pause_s: float = 0.005,
) -> T:
    """Wait until the condition holds.

    Args:
        condition: polled; returns a true value once it holds.
        what: text for the failure message.
        step: called between polls, for a component that the test drives.
        pause_s: wall-clock seconds between two polls.

    Returns: the value of the condition.

    """
    deadline_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > deadline_s:
            pytest.fail(what)
        step()
        time.sleep(pause_s)
    return found


def has_ended(pid: int) -> bool:
    """Whether a process has ended; this includes one that its parent has not reaped yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True
