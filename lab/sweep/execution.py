"""Runs the runs of a sweep, or the trials of a soak, by a crew, and hands each record on as it comes."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from typing import TypeVar

from robrain.lab.sweep.crew import Crew
from robrain.lab.sweep.run_outcome import RunState

CHECK_S = 0.2
"""Period of the checks for an interrupt."""
DIED = "its process ended without a result: it was killed, or the memory was not enough"


T = TypeVar("T")
R = TypeVar("R")


def execute(
    tasks: Iterable[T],
    crew: Crew[T, R],
    on_record: Callable[[R], None],
    without_result: Callable[[T, RunState, str], R],
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Run all tasks, or the tasks that end before `should_stop`.

    Args:
        tasks: in the order in which they begin.
        crew: runs them; the caller closes it.
        on_record: called with the record of each task that has begun, in the order in which they end.
        without_result: makes the record of a task that ended without one, of its state and the reason.
        should_stop: called several times a second; if true, the running tasks are interrupted.

    """
    waiting = deque(tasks)
    running: dict[Future[R], T] = {}
    is_stopping = should_stop()
    while running or (waiting and not is_stopping):
        while waiting and crew.has_room and not is_stopping:
            task = waiting.popleft()
            running[crew.submit(task)] = task
        ended, _ = wait(running, CHECK_S, FIRST_COMPLETED)
        for future in ended:
            task = running.pop(future)
            try:
                record = future.result()
            except Exception as error:  # noqa: BLE001 - whatever a cluster says of a worker that is gone
                record = without_result(task, *_end_of(error, is_stopping=is_stopping))
            crew.release(future)
            on_record(record)
        if should_stop() and not is_stopping:
            is_stopping = True
            crew.stop()


def _end_of(error: Exception, *, is_stopping: bool) -> tuple[RunState, str]:
    if isinstance(error, CancelledError):
        return (RunState.INTERRUPTED, "") if is_stopping else (RunState.FAILED, "the cluster dropped it")
    if isinstance(error, BrokenExecutor):
        return RunState.FAILED, DIED
    return RunState.FAILED, f"{type(error).__name__}: {error}"
