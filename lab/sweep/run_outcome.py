"""Outcome of a run in a sweep: values that depend on scenario and seed alone, and values of the machine."""

from enum import StrEnum
from typing import Any

import msgspec

from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.result import RunResult


class RunState(StrEnum):
    """State of a run of a sweep."""

    DONE = "done"
    FAILED = "failed"
    """It raised an error, or its process died; the next call of the sweep tries it again."""
    INTERRUPTED = "interrupted"
    """The sweep was interrupted while it ran; the next call runs it again."""
    NOT_RUN = "not_run"
    """It has not begun."""


class RunOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Results of a run that are equal on every machine; None where there is no measurement."""

    robots: int
    motes: int
    ended: str
    """`explored`, `nothing_left`, `tasks_ended` or `time_limit`."""
    sim_time_s: float
    explored_share: float
    explored_50_s: float | None = None
    """Simulated time at which 50 % of the reachable floor was explored; None if the run ended before."""
    explored_90_s: float | None = None
    explored_95_s: float | None = None
    explored_99_s: float | None = None
    distance_m: float
    """Of all robots together, the next two as well."""
    energy_j: float
    tasks_done: int | None = None
    """Tasks of the scenario; None if it has none, the next four as well."""
    tasks_failed: int | None = None
    """Failed, cancelled or refused."""
    tasks_open: int | None = None
    """At the end of the run."""
    makespan_s: float | None = None
    """Simulated time at which the last task ended; None if one is open."""
    energy_per_task_j: float | None = None
    """Of all robots together, over the tasks that are done."""
    waiting_s: float = 0.0
    """Of all robots together: they stand with a task, for other robots, for a path, or at work."""
    idle_s: float = 0.0
    """Of all robots together: they stand without a task."""
    overlap: float = 0.0
    """Area that each robot has seen, summed over the robots, over the area that any has seen, less one."""
    collisions: int
    wall_overlap_m: float
    map_cells_off_share: float | None = None
    """Share of the map's occupied cells that are off the true walls."""
    map_walls_doubled_m: float | None = None
    position_rmse_m: float | None = None
    """Of the worst robot, the next one as well."""
    position_error_max_m: float | None = None
    lost_s: float | None = None
    """Of all robots together, the next one as well."""
    silent_divergence_s: float | None = None
    invariants_broken: int | None = None
    """Number of invariants that the run broke (`robrain check`); None in tables of earlier versions."""
    messages: int
    mote_readings: int
    robot_distance_m: tuple[float, ...]
    """By robot, the next two as well."""
    robot_energy_j: tuple[float, ...]
    robot_collisions: tuple[int, ...]
    curve_t_s: tuple[float, ...]
    """Simulated times of `curve_explored_share`."""
    curve_explored_share: tuple[float, ...]
    digest: str
    """SHA-256 over every message of the run."""


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One run that has ended, as the journal of a sweep keeps it."""

    run: str
    """Name of the run."""
    state: RunState
    error: str = ""
    """Reason for its failure."""
    outcome: RunOutcome | None = None
    """None unless it is done."""
    wall_time_s: float = 0.0
    recording: str | None = None
    """File name below `recordings/`."""


def outcome_of(result: RunResult, invariants_broken: int | None = None) -> RunOutcome:
    """The part of a result that is equal on every machine, and how many invariants the run broke, if it was judged."""
    of_map = result.map_accuracy
    accuracies = [robot.pose_accuracy for robot in result.per_robot if robot.pose_accuracy is not None]
    reached = result.explored_percent_s
    return RunOutcome(
        robots=result.robots,
        motes=result.motes,
        ended=result.ended,
        sim_time_s=result.sim_time_s,
        explored_share=result.explored_fraction,
        explored_50_s=reached.get(50),
        explored_90_s=reached.get(90),
        explored_95_s=reached.get(95),
        explored_99_s=reached.get(99),
        distance_m=result.distance_m,
        energy_j=result.energy_j,
        **_of_tasks(result),
        waiting_s=round(sum(robot.time_use.waiting_s for robot in result.per_robot), 3),
        idle_s=round(sum(robot.time_use.idle_s for robot in result.per_robot), 3),
        overlap=result.overlap,
        collisions=result.collisions,
        wall_overlap_m=result.wall_overlap_m,
        map_cells_off_share=of_map.share_off if of_map is not None else None,
        map_walls_doubled_m=of_map.doubled_walls_m if of_map is not None else None,
        position_rmse_m=max((each.rmse_m for each in accuracies if each.rmse_m is not None), default=None),
        position_error_max_m=max(
            (each.max_error_m for each in accuracies if each.max_error_m is not None), default=None
        ),
        lost_s=sum(each.lost_s for each in accuracies) if accuracies else None,
        silent_divergence_s=sum(each.silent_divergence_s for each in accuracies) if accuracies else None,
        invariants_broken=invariants_broken,
        messages=result.messages,
        mote_readings=result.mote_readings,
        robot_distance_m=tuple(robot.distance_m for robot in result.per_robot),
        robot_energy_j=tuple(robot.energy_j for robot in result.per_robot),
        robot_collisions=tuple(robot.collisions for robot in result.per_robot),
        curve_t_s=tuple(time_s for time_s, _ in result.explored_curve),
        curve_explored_share=tuple(share for _, share in result.explored_curve),
        digest=result.digest,
    )


def _of_tasks(result: RunResult) -> dict[str, Any]:
    if not result.tasks:
        return {}
    done = sum(task.state is TaskState.DONE for task in result.tasks)
    is_open = [
        (task.state is not None and not task.state.ended) or (task.state is None and not task.why)
        for task in result.tasks
    ]
    ends_s = [task.ended_s for task in result.tasks if task.ended_s is not None]
    return {
        "tasks_done": done,
        "tasks_failed": len(result.tasks) - done - sum(is_open),
        "tasks_open": sum(is_open),
        "makespan_s": max(ends_s, default=None) if not any(is_open) else None,
        "energy_per_task_j": result.energy_j / done if done else None,
    }
