"""The processes of a sweep: forked from one that has loaded everything, and nothing of the sweep's own process."""

import os
import sys
from pathlib import Path

import pytest

from robrain.lab.sweep.crew import ONE_THREAD, LocalCrew

pytestmark = pytest.mark.system
PRELOADED = "robrain.lab.sweep.forked_from"


def family(_: None) -> tuple[int, int, int, bool, list[str | None]]:
    """Process, parent, the parent's threads, whether the kernels were loaded before, and the variables."""
    parent = os.getppid()
    threads = len(list(Path(f"/proc/{parent}/task").iterdir()))
    return os.getpid(), parent, threads, PRELOADED in sys.modules, [os.environ.get(name) for name in ONE_THREAD]


def test_workers_have_a_parent_of_one_thread_that_has_loaded_the_kernels() -> None:
    crew = LocalCrew(2, family)
    try:
        futures = [crew.submit(None), crew.submit(None)]
        assert not crew.has_room
        found = [future.result() for future in futures]
        for future in futures:
            crew.release(future)
        assert crew.has_room
    finally:
        crew.close()
    (one, parent, threads, is_loaded, variables), (other, same, *_) = found
    assert one != other
    assert parent == same != os.getpid()
    assert (threads, is_loaded, variables) == (1, True, ["1"] * len(ONE_THREAD))
