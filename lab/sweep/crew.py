"""Executors for the runs of a sweep or a soak: processes of this computer, or a Dask cluster."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from typing import Generic, Protocol, TypeVar

from robrain.deploy.errors import UsageError
from robrain.deploy.processes.process_setup import ONE_THREAD
from robrain.lab.sweep.run_outcome import RunRecord
from robrain.lab.sweep.worker import STOP, RunTask, run_task, start_worker
from robrain.recording.provenance import software_versions

CONNECT_S = 10.0


T = TypeVar("T")
R = TypeVar("R")
T_contra = TypeVar("T_contra", contravariant=True)


class Crew(Protocol[T_contra, R]):
    """Runs tasks, each in a separate process."""

    @property
    def has_room(self) -> bool:
        """Whether another task can be submitted now."""
        ...

    def submit(self, task: T_contra) -> Future[R]:
        """Start a task, or put it into the queue of a cluster."""
        ...

    def release(self, future: Future[R]) -> None:
        """Record that a task has ended; a process that died is replaced."""
        ...

    def stop(self) -> None:
        """Ask the running tasks to end soon, and drop the waiting ones."""
        ...

    def close(self) -> None:
        """End the processes, or the connection; call it once."""
        ...


class _Lane(Generic[T, R]):
    """One process. A pool for each, so that a process that dies ends no other run."""

    def __init__(self, work: Callable[[T], R]) -> None:
        self._work = work
        context = _context()
        ours, theirs = context.Pipe()
        self._commands: Connection = ours
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=start_worker, initargs=(theirs,))

    def submit(self, task: T) -> Future[R]:
        with _no_interrupt():
            return self._pool.submit(self._work, task)

    def stop(self) -> None:
        self._commands.send_bytes(STOP)

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._commands.close()


class LocalCrew(Generic[T, R]):
    """Processes of this computer.

    Args:
        workers: number of processes.
        work: function that each calls with a task; a function of a module, which the processes import.

    """

    def __init__(self, workers: int, work: Callable[[T], R]) -> None:
        self._work = work
        self._idle = [_Lane(work) for _ in range(workers)]
        self._busy: dict[Future[R], _Lane[T, R]] = {}

    @property
    def has_room(self) -> bool:
        """Whether a process is idle."""
        return bool(self._idle)

    def submit(self, task: T) -> Future[R]:
        """Start a task in an idle process."""
        lane = self._idle.pop()
        with _one_thread_each():
            try:
                future = lane.submit(task)
            except BrokenProcessPool:  # it died while it was idle
                lane.close()
                lane = _Lane(self._work)
                future = lane.submit(task)
        self._busy[future] = lane
        return future

    def release(self, future: Future[R]) -> None:
        """Record that a task has ended; a process that died is replaced."""
        lane = self._busy.pop(future)
        if isinstance(future.exception(), BrokenProcessPool):
            lane.close()
            lane = _Lane(self._work)
        self._idle.append(lane)

    def stop(self) -> None:
        """Ask the running tasks to end soon."""
        for lane in self._busy.values():
            lane.stop()

    def close(self) -> None:
        """End the processes."""
        for lane in (*self._idle, *self._busy.values()):
            lane.close()


class DaskCrew:
    """The workers of a Dask cluster.

    Args:
        address: of its scheduler, such as `tcp://127.0.0.1:8786`.

    Raises:
        UsageError: no scheduler answers there.

    """

    def __init__(self, address: str) -> None:
        from distributed import Client

        try:
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(f"--dask {address}: no scheduler of Dask answers there: {error}") from error
        self._executor: Executor = self._client.get_executor(pure=False)
        self.versions = software_versions()

    @property
    def has_room(self) -> bool:
        """The cluster has a queue."""
        return True

    def submit(self, task: RunTask) -> Future[RunRecord]:
        """Put a task into the cluster's queue; a worker of other versions refuses it."""
        import msgspec

        return self._executor.submit(run_task, msgspec.structs.replace(task, versions=self.versions))

    def release(self, future: Future[RunRecord]) -> None:
        """Do nothing: the cluster replaces its own workers."""

    def stop(self) -> None:
        """Drop the waiting tasks; running ones end on the cluster, and their results are dropped."""
        self._executor.shutdown(wait=False)

    def close(self) -> None:
        """End the connection."""
        self._client.close()


def _context() -> BaseContext:
    """Workers are forked from a process that has all modules loaded, which saves each of them some seconds.

    They are not forked from this one, as they would share the locks of Zenoh's threads.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # Windows
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["robrain.lab.sweep.forked_from"])
    return context


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Ctrl-C at a terminal goes to all its processes; processes started in this block never receive it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
