"""Means and comparisons of a sweep, and what they leave out."""

import math

import pytest

from robrain.deploy.sweep.plan import SweepPlan, make_plan
from robrain.deploy.sweep.run_outcome import RunRecord, RunState
from robrain.deploy.sweep.summary import summarise, summary_csv
from tests.deploy.sweep.conftest import SCENARIO, done, records


def test_the_mean_of_each_setting_has_its_interval(plan: SweepPlan) -> None:
    summary = summarise(plan, records(plan, [[10, 20, 30], [5, 5, 5]]))
    one, two = (setting.means["explored_90_s"] for setting in summary.settings)
    assert (one.mean, one.n) == (20.0, 3)
    assert one.high is not None
    assert one.high - one.mean == pytest.approx(4.302652729911275 * 10 / math.sqrt(3))  # t with 2 degrees, table value
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
        told[run.name] = done(run.name, explored_share=0.5 + 0.2 * run.setting, energy_j=100.0 + run.setting)
    summary = summarise(plan, told)
    assert [each.share_better for each in summary.compared("explored_share")] == [1.0]
    assert [each.share_better for each in summary.compared("energy_j")] == [0.0]


def test_p_values_are_corrected_for_the_number_of_settings() -> None:
    plan = make_plan(SCENARIO, [1, 2, 3], {"robots": [1, 2, 3]})
    pairs = records(plan, [[10, 20, 30], [8, 19, 31], [8, 19, 31]])
    alone = make_plan(SCENARIO, [1, 2, 3], {"robots": [1, 2]})
    [single] = summarise(alone, records(alone, [[10, 20, 30], [8, 19, 31]])).compared("explored_90_s")
    assert single.p_holm is not None
    both = summarise(plan, pairs).compared("explored_90_s")
    assert [each.p_holm for each in both] == [pytest.approx(min(1.0, 2 * single.p_holm))] * 2


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


def test_a_run_that_did_not_get_there_has_no_time(plan: SweepPlan) -> None:
    summary = summarise(plan, records(plan, [[10, None, 30], [5, 5, 5]]))
    assert summary.settings[0].means["explored_90_s"].n == 2
    [found] = summary.compared("explored_90_s")
    assert found.paired.difference.n == 2


@pytest.mark.parametrize(
    ("fifty", "ninety", "milestone"),
    [(9.0, 20.0, "explored_90_s"), (9.0, None, "explored_50_s"), (None, None, None)],
)
def test_the_milestone_is_the_hardest_that_all_runs_reached(
    plan: SweepPlan, fifty: float | None, ninety: float | None, milestone: str | None
) -> None:
    found = {run.name: done(run.name, ninety, explored_50_s=fifty) for run in plan.runs()}
    assert summarise(plan, found).milestone == milestone


def test_the_milestone_is_one_that_some_reached_if_no_other_is(plan: SweepPlan) -> None:
    assert summarise(plan, records(plan, [[10, None, 30], [5, 5, 5]])).milestone == "explored_90_s"


def test_nothing_done_has_no_means(plan: SweepPlan) -> None:
    summary = summarise(plan, {})
    assert (summary.comparisons, summary.milestone) == ([], None)
    assert [setting.means for setting in summary.settings] == [{}, {}]


def test_the_means_are_a_table_as_well(plan: SweepPlan) -> None:
    lines = summary_csv(summarise(plan, records(plan, [[10, 20, 30], [5, 5, 5]]))).decode().splitlines()
    assert lines[0] == "setting,column,n,mean,low_95,high_95"
    assert "robots=2,explored_90_s,3,5.0,5.0,5.0" in lines
