"""Runs the runs of a plan by a crew, and hands each record on as it comes."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait

from robrain.deploy.sweep.crew import Crew
from robrain.deploy.sweep.run_outcome import RunRecord, RunState
from robrain.deploy.sweep.worker import RunTask

LOOK_S = 0.2
"""How often an interrupt is looked for."""
DIED = "its process ended without a result: it was killed, or the memory was not enough"


def execute(
    tasks: Iterable[RunTask],
    crew: Crew,
    on_record: Callable[[RunRecord], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Run all tasks, or those that end before `should_stop`.

    Args:
        tasks: in the order in which they begin.
        crew: runs them; the caller closes it.
        on_record: called with the record of each task that has begun, in the order in which they end.
        should_stop: looked at several times a second; then the running tasks are interrupted.

    """
    waiting = deque(tasks)
    running: dict[Future[RunRecord], RunTask] = {}
    is_stopping = should_stop()
    while running or (waiting and not is_stopping):
        while waiting and crew.has_room and not is_stopping:
            task = waiting.popleft()
            running[crew.submit(task)] = task
        ended, _ = wait(running, LOOK_S, FIRST_COMPLETED)
        for future in ended:
            task = running.pop(future)
            record = _record_of(future, task, is_stopping=is_stopping)
            crew.release(future)
            on_record(record)
        if should_stop() and not is_stopping:
            is_stopping = True
            crew.stop()


def _record_of(future: Future[RunRecord], task: RunTask, *, is_stopping: bool) -> RunRecord:
    try:
        return future.result()
    except CancelledError:
        state, why = (RunState.INTERRUPTED, "") if is_stopping else (RunState.FAILED, "the cluster dropped it")
    except BrokenExecutor:
        state, why = RunState.FAILED, DIED
    except Exception as error:  # noqa: BLE001 - whatever a cluster says of a worker that is gone
        state, why = RunState.FAILED, f"{type(error).__name__}: {error}"
    return RunRecord(run=task.run, state=state, error=why)
