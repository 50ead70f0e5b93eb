"""Drives a run to its end, and notes how much of the floor was explored when."""

from collections.abc import Callable
from typing import NamedTuple

from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.pacing import Pacer, StopOnInterrupt

CURVE_STEP_S = 5.0
MILESTONES_PERCENT = (50, 90, 95, 99)
"""Explored shares whose times a result reports."""


class Progress(NamedTuple):
    """Progress of a run, reported about ten times per second of wall time."""

    sim_time_s: float
    wall_time_s: float
    explored_fraction: float
    messages: int


def drive(
    run: LockstepRun,
    until_explored: float,
    time_limit_s: float,
    pacer: Pacer,
    on_progress: Callable[[Progress], None] | None,
) -> tuple[str, list[tuple[float, float]], dict[int, float]]:
    """Tick a run until `end_reason` gives a reason to end.

    Args:
        run: set up, before its first tick.
        until_explored: explored share at which it ends.
        time_limit_s: simulated time at which it ends at the latest.
        pacer: waits between the ticks.
        on_progress: called with the progress about ten times a second.

    Returns:
        Why it ended; times, in simulated seconds, with the explored share; the times of `MILESTONES_PERCENT`.

    """
    curve: list[tuple[float, float]] = [(0.0, 0.0)]
    milestones: dict[int, float] = {}
    reported_s = -1.0
    with StopOnInterrupt() as interrupt:
        while True:
            run.tick()
            sim_time_s, explored = run.sim_time_s, run.explored_fraction
            if sim_time_s - curve[-1][0] >= CURVE_STEP_S - 1e-9:
                curve.append((round(sim_time_s, 3), explored))
            while len(milestones) < len(MILESTONES_PERCENT) and 100 * explored >= MILESTONES_PERCENT[len(milestones)]:
                milestones[MILESTONES_PERCENT[len(milestones)]] = round(sim_time_s, 3)
            if on_progress is not None and pacer.wall_time_s - reported_s > 0.1:
                reported_s = pacer.wall_time_s
                on_progress(Progress(sim_time_s, reported_s, explored, run.messages))
            ended = end_reason(run, until_explored, time_limit_s, interrupted=interrupt.requested)
            if ended:
                break
            pacer.wait(sim_time_s)
    if curve[-1][0] != round(sim_time_s, 3):
        curve.append((round(sim_time_s, 3), explored))
    if on_progress is not None:
        on_progress(Progress(sim_time_s, pacer.wall_time_s, explored, run.messages))
    return ended, curve, milestones


def end_reason(run: LockstepRun, until_explored: float, time_limit_s: float, *, interrupted: bool) -> str:
    """Reason why a run ends now, as in `RunResult.ended`; empty while it continues.

    While a task of the scenario or of a rule is open, only Ctrl-C and the time limit end it. A team that does not
    explore by itself ends with the tasks of its scenario, if that has any.
    """
    if interrupted:
        return "interrupted"
    is_done = run.arena.tasks.all_ended and not run.has_open_alarm
    if is_done and run.explored_fraction >= until_explored:
        return "explored"
    if run.sim_time_s >= time_limit_s - 1e-9:
        return "time_limit"
    if is_done and run.world.idle and run.world.tasks:
        return "tasks_ended"
    return "nothing_left" if is_done and run.nothing_left else ""
