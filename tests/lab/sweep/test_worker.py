"""What a worker of a sweep tells of a run."""

import pytest

from robrain.lab.sweep.run_outcome import RunState
from robrain.lab.sweep.worker import RunTask, run_task
from robrain.sim.firmware.battery import SimulatedBattery
from robrain.sim.scenarios.scenario import Scenario

TASK = RunTask(run="one", seed=2, toml=Scenario.builtin("arena_small").replace(time_limit_s=3.0, motes=0).to_toml())


def broken_by_a_run() -> int | None:
    record = run_task(TASK)
    assert record.state is RunState.DONE, record.error
    assert record.outcome is not None
    return record.outcome.invariants_broken


@pytest.mark.slow
def test_a_run_that_keeps_its_invariants_breaks_none() -> None:
    assert broken_by_a_run() == 0


@pytest.mark.slow
def test_broken_invariants_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    step = SimulatedBattery.step

    def leaks(battery: SimulatedBattery, *given: float) -> None:
        step(battery, *given)
        battery.delivered_j -= 20.0

    monkeypatch.setattr(SimulatedBattery, "step", leaks)
    assert broken_by_a_run() == 1
