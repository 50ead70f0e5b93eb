"""Waiting for what has to come to pass: the wait ends when it does, and the limit is for what never will.

A limit says nothing about speed. It is far above what the slowest loaded machine takes, so that no test fails for being
run beside other work; a test that hangs is ended by it all the same.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")

PATIENCE_S = 180.0
"""The longest wait for anything; below the limit that pytest sets for one test."""


def until(
    condition: Callable[[], T],
    what: str = "it has not come to pass",
    *,
    step: Callable[[], object] = lambda: None,
    pause_s: float = 0.005,
) -> T:
    """Wait until the condition holds.

    Args:
        condition: asked again and again; what it returns is true when it holds.
        what: said when it never does.
        step: called between, for a component that the test itself drives.
        pause_s: wall-clock seconds between two looks.

    Returns: what the condition returned.

    """
    deadline_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > deadline_s:
            pytest.fail(what)
        step()
        time.sleep(pause_s)
    return found


def has_ended(pid: int) -> bool:
    """Whether a process runs no more; one that its parent has not reaped yet has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True
