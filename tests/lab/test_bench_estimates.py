"""Accuracy of estimates, in one small run; the figures themselves take minutes."""

import msgspec
import pytest

from robrain.lab.bench import estimates
from robrain.lab.bench.estimates import EstimatesRun, choose, figures, run_case


@pytest.mark.slow
def test_ends_and_energies_of_a_few_tasks_are_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(estimates.EXPLORED_S, "arena_small", 25.0)
    monkeypatch.setattr(estimates, "TASK_S", 30.0)
    (case,) = choose("arena_small", "2", "3", tasks=3, jobs=1).cases
    run = run_case(case)
    assert (len(run.done), run.without, run.undone) == (3, 0, 0)
    for one in run.done:
        assert one.begun_ends_in_s == pytest.approx(one.begun_ended_in_s, rel=0.3, abs=2.0)
        assert one.energy_j == pytest.approx(one.spent_j, rel=0.3, abs=15.0)
    found = {one.name: one.value for one in figures([run])}
    assert found["tasks that were not done"] == 0.0
    assert 0.0 <= found["error of the end, at submission"] < 30.0


def test_figures_are_medians_of_absolute_errors_and_shares_within_intervals() -> None:
    (case,) = choose("office", "4", "1", tasks=3, jobs=1).cases
    times = {"ended_in_s": 10.0, "begun_ended_in_s": 5.0, "spent_j": 100.0, "kind": "visit"}
    done = [
        {
            **times,
            "ends_in_s": ends,
            "is_inside": ends < 13.0,
            "begun_ends_in_s": 5.5,
            "begun_is_inside": True,
            "energy_j": 98.0,
        }
        for ends in (9.0, 12.0, 20.0)
    ]
    run = EstimatesRun(case=case, done=msgspec.convert(done, type=EstimatesRun.__annotations__["done"]))
    values = [round(one.value, 1) for one in figures([run])]
    assert values == [20.0, 10.0, 2.0, 66.7, 100.0, 0.0]
