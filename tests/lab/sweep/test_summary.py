"""Means and comparisons of a sweep, and what they leave out."""

import msgspec
import pytest

from robrain.lab.sweep.plan import SweepPlan
from robrain.lab.sweep.run_outcome import RunRecord, RunState, outcome_of
from robrain.lab.sweep.summary import summarise
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.result import RunResult
from robrain.sim.world.scenario_tasks import TaskOutcome
from tests.lab.sweep.conftest import done, records


def test_the_mean_of_each_setting_has_its_interval(plan: SweepPlan) -> None:
    summary = summarise(plan, records(plan, [[10, 20, 30], [5, 5, 5]]))
    one, two = (setting.means["explored_90_s"] for setting in summary.settings)
    assert (one.mean, one.n) == (20.0, 3)
    assert (one.low, one.high) == (10.0, 30.0)  # of the 27 samples of three values one has all equal: more than 2.5 %
    assert (two.low, two.mean, two.high) == (5.0, 5.0, 5.0)


def test_settings_are_compared_with_the_first_by_seed(plan: SweepPlan) -> None:
    [found] = summarise(plan, records(plan, [[10, 20, 30], [8, 19, 31]])).compared("explored_90_s")
    assert (found.setting, found.base) == ("robots=2", "robots=1")
    assert found.paired.difference.mean == pytest.approx(-2 / 3)
    assert found.share_better == pytest.approx(2 / 3)
    assert found.p_holm is not None
    assert found.p_holm == pytest.approx(0.529, abs=0.001)  # t = -0.756, 2 degrees of freedom


def test_more_explored_is_better_and_more_energy_is_not(plan: SweepPlan) -> None:
    told = {}
    for run in plan.runs():
        ended = {"ended": "nothing_left", "explored_share": 0.5 + 0.2 * run.setting}
        told[run.name] = done(run.name, **ended, energy_j=100.0 + run.setting)
    summary = summarise(plan, told)
    assert [each.share_better for each in summary.compared("explored_share")] == [1.0]
    assert [each.share_better for each in summary.compared("energy_j")] == [0.0]


@pytest.mark.parametrize(("ended", "column"), [("explored", "explored_share"), ("time_limit", "sim_time_s")])
def test_what_the_stop_criterion_decides_is_not_compared(plan: SweepPlan, ended: str, column: str) -> None:
    told = {run.name: done(run.name, ended=ended, **{column: 0.95 + 0.001 * run.setting}) for run in plan.runs()}
    summary = summarise(plan, told)
    assert summary.compared(column) == []
    assert summary.compared("energy_j") != []
    assert summary.settings[0].means[column].mean == pytest.approx(0.95)


def test_runs_that_are_not_done_are_counted_and_left_out(plan: SweepPlan) -> None:
    found = records(plan, [[10, 20, 30], [5, 6, 7]])
    names = [run.name for run in plan.runs()]
    found[names[0]] = RunRecord(run=names[0], state=RunState.FAILED, error="x")
    found[names[1]] = RunRecord(run=names[1], state=RunState.INTERRUPTED)
    del found[names[5]]
    summary = summarise(plan, found)
    assert summary.settings[0].runs == {"done": 1, "failed": 1, "interrupted": 1}
    assert summary.settings[1].runs == {"done": 2, "not_run": 1}
    one = summary.settings[0].means["explored_90_s"]
    assert (one.mean, one.low, one.high, one.n) == (30.0, None, None, 1)
    assert summary.compared("explored_90_s") == []  # no seed has both


@pytest.mark.parametrize(
    ("fifty", "ninety", "milestone"),
    [(9.0, 20.0, "explored_90_s"), (9.0, None, "explored_50_s"), (None, None, None)],
)
def test_the_milestone_is_the_hardest_that_all_runs_reached(
    plan: SweepPlan, fifty: float | None, ninety: float | None, milestone: str | None
) -> None:
    found = {run.name: done(run.name, ninety, explored_50_s=fifty) for run in plan.runs()}
    assert summarise(plan, found).milestone == milestone


RESULT = RunResult(
    scenario="room", seed=1, robots=1, motes=0, ended="time_limit", sim_time_s=10.0, wall_time_s=1.0, setup_time_s=0.0,
    real_time_factor=10.0, explored_fraction=0.5, explored_curve=[], distance_m=1.0, energy_j=300.0, collisions=0,
    wall_overlap_m=0.0, per_robot=[], messages=0, outside_messages=0, mote_readings=0, recording=None, digest="",
)  # fmt: skip
DONE, FAILED, QUEUED = TaskState.DONE, TaskState.FAILED, TaskState.QUEUED


@pytest.mark.parametrize(
    ("tasks", "counts", "makespan_s", "per_task_j"),
    [
        ([(DONE, 5.0), (DONE, 9.0)], (2, 0, 0), 9.0, 150.0),
        ([(DONE, 5.0), (FAILED, 9.0)], (1, 1, 0), 9.0, 300.0),
        ([(DONE, 5.0), (QUEUED, None)], (1, 0, 1), None, 300.0),
        ([(None, None)], (0, 1, 0), None, None),
        ([], (None, None, None), None, None),
    ],
)
def test_an_outcome_has_what_became_of_the_tasks(
    tasks: list[tuple[TaskState | None, float | None]],
    counts: tuple[int | None, ...],
    makespan_s: float | None,
    per_task_j: float | None,
) -> None:
    outcomes = [
        TaskOutcome(task=f"t{number}", kind="visit", state=state, ended_s=ended_s, why="" if state else "refused")
        for number, (state, ended_s) in enumerate(tasks)
    ]
    found = outcome_of(msgspec.structs.replace(RESULT, tasks=outcomes))
    assert (found.tasks_done, found.tasks_failed, found.tasks_open) == counts
    assert (found.makespan_s, found.energy_per_task_j) == (makespan_s, per_task_j)
