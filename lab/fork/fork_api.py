"""`robrain.fork`: forks for scripts and notebooks.

import robrain

result = robrain.fork("run.mcap", at_s=20.0, without=["r2"], tasks=[("visit", {"place": (8.0, 9.9)})])
print(result.same_before, result.explored_fraction)
for row in robrain.compare_runs("run.mcap", result.recording).rows:
    print(row.group, row.name, row.first, row.second)
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.fork.changes import AddFault, AddTask, Change, SetPolicy, Without
from robrain.lab.fork.fork_result import ForkResult, fork_name
from robrain.lab.fork.forking import fork_run
from robrain.lab.fork.recorded_run import recorded_run
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.scenarios.driving import Progress


def fork(
    recording: Path | str,
    at_s: float,
    *,
    without: Sequence[str] = (),
    tasks: Sequence[tuple[str, Mapping[str, Any]]] = (),
    planning: PlanningPolicy | None = None,
    faults: Sequence[FaultSpec] = (),
    seconds: float | None = None,
    output: Path | str | None = None,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> ForkResult:
    """Repeat a recorded run up to a moment, compare it with the recording so far, and continue with changes from there.

    Args:
        recording: MCAP file of a lockstep run.
        at_s: the moment, seconds on the run's clock.
        without: robots whose computers are switched off at the moment.
        tasks: kind and fields of each task to submit then, named as in `Team.submit` and its `parameters`.
        planning: parameters to plan with from then on.
        faults: hardware faults to add, each with its own time, not before the moment.
        seconds: duration after the moment; until the recorded run would have ended, if None.
        output: MCAP file to write; `NAME.fork-TIME.mcap` beside the recording if None.
        overwrite: whether an existing file is replaced.
        on_progress: called with the progress of the run.

    Raises:
        RobrainError: the run cannot be forked so; the text gives the reason, and no file remains.

    """
    path = Path(recording)
    changes: list[Change] = [AddFault(fault=fault) for fault in faults]
    changes += [Without(at_s=at_s, robot=robot) for robot in without]
    changes += [SetPolicy(at_s=at_s, planning=planning)] if planning is not None else []
    changes += [AddTask(at_s=at_s, kind=kind, fields=msgspec.to_builtins(dict(fields))) for kind, fields in tasks]
    with recorded_run(path) as recorded:
        return fork_run(
            recorded,
            at_s,
            changes,
            output=Path(output) if output is not None else fork_name(path, at_s),
            seconds=seconds,
            overwrite=overwrite,
            on_progress=on_progress,
        )
