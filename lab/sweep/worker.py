"""Runs one run of a sweep; in a process of the sweep's own, or on a worker of a Dask cluster."""

import os
import threading
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec

from robrain.deploy.recordings.surroundings import surroundings_of
from robrain.lab.bench.mapping_plan import errors_alone
from robrain.lab.sweep.run_outcome import RunRecord, RunState, outcome_of
from robrain.protocol.errors import RobrainError
from robrain.protocol.workers import OwnedThread
from robrain.recording.invariants.judging import Judging, broken
from robrain.recording.provenance import software_versions
from robrain.sim.scenarios.driving import Progress
from robrain.sim.scenarios.scenario import Scenario

STOP = b"stop"
_STOPPING = threading.Event()
_ONE_RUN = threading.Lock()
"""A Dask worker may have several threads; a process runs one run at a time."""


class RunTask(msgspec.Struct, frozen=True, kw_only=True):
    """Input of a worker."""

    run: str
    toml: str
    seed: int
    recording: str | None = None
    """Path of the MCAP file to write."""
    versions: dict[str, str] = {}
    """Versions that the worker must have; none are checked if empty."""


class _Stopped(Exception):
    """The sweep was interrupted."""


def run_task(task: RunTask) -> RunRecord:
    """Run one run. An error of the run is part of the record, so that it does not end the sweep."""
    with _ONE_RUN, errors_alone():
        try:
            return _done(task)
        except _Stopped:
            _discard(task)
            return RunRecord(run=task.run, state=RunState.INTERRUPTED)
        except RobrainError as error:
            text = str(error)
        except Exception as error:  # noqa: BLE001 - allocators, strategies and passes of other distributions run here
            text = f"{type(error).__name__}: {error}"
        _discard(task)
        return RunRecord(run=task.run, state=RunState.FAILED, error=text)


def start_worker(commands: Connection) -> None:
    """Make this process ready for tasks: it stops on request, and ends when the sweep's process is gone."""
    OwnedThread("sweep", _obey, commands)  # it ends with the process


def is_asked_to_stop() -> bool:
    """Whether the sweep or soak was interrupted."""
    return _STOPPING.is_set()


def _done(task: RunTask) -> RunRecord:
    own = software_versions()
    if different := [name for name, version in task.versions.items() if own.get(name) != version]:
        versions = ", ".join(f"{name} {own.get(name, 'missing')}, expected {task.versions[name]}" for name in different)
        return RunRecord(run=task.run, state=RunState.FAILED, error=f"the worker has {versions}")
    scenario = Scenario.from_toml(task.toml, task.run).replace(seed=task.seed)
    _discard(task)
    if task.recording is not None:
        Path(task.recording).parent.mkdir(parents=True, exist_ok=True)
    _stop_if_asked()
    judging = Judging(surroundings_of(scenario))
    result = scenario.run(
        record=task.recording, on_progress=_stop_if_asked, before_start=lambda run: run.follow(judging.receive)
    )
    if result.ended == "interrupted":
        raise _Stopped
    return RunRecord(
        run=task.run,
        state=RunState.DONE,
        outcome=outcome_of(result, broken(judging.finish())),
        wall_time_s=result.setup_time_s + result.wall_time_s,
        recording=Path(task.recording).name if task.recording is not None else None,
    )


def _discard(task: RunTask) -> None:
    """Remove the remaining recording of an attempt that did not end."""
    if task.recording is not None:
        Path(task.recording).unlink(missing_ok=True)


def _stop_if_asked(_progress: Progress | None = None) -> None:
    if is_asked_to_stop():
        raise _Stopped


def _obey(commands: Connection) -> None:
    try:
        while commands.recv_bytes() == STOP:
            _STOPPING.set()
    except (EOFError, OSError):  # the sweep's process was killed: the result has no receiver
        os._exit(1)
