"""Plans and records of small sweeps; one that has been run on two processes."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from robrain import Scenario
from robrain.lab.sweep.plan import SweepPlan, make_plan
from robrain.lab.sweep.run_outcome import RunOutcome, RunRecord, RunState
from robrain.lab.sweep.sweep import SweepResult, sweep

SEEDS = (1, 2, 3)
VARY = {"robots": [1, 2]}
SCENARIO = Scenario.builtin("arena_small").replace(time_limit_s=4.0)


def outcome(explored_90_s: float | None = 50.0, **fields: object) -> RunOutcome:
    told = {
        "robots": 1, "motes": 0, "ended": "explored", "sim_time_s": 60.0, "explored_share": 0.95,
        "explored_90_s": explored_90_s, "distance_m": 20.0, "energy_j": 500.0, "collisions": 0, "wall_overlap_m": 0.0,
        "messages": 100, "mote_readings": 0, "robot_distance_m": (20.0,), "robot_energy_j": (500.0,),
        "robot_collisions": (0,), "curve_t_s": (0.0, 60.0), "curve_explored_share": (0.0, 0.95), "digest": "d",
    }  # fmt: skip
    return RunOutcome(**{**told, **fields})  # type: ignore[arg-type]


def done(run: str, explored_90_s: float | None = 50.0, **fields: object) -> RunRecord:
    return RunRecord(run=run, state=RunState.DONE, outcome=outcome(explored_90_s, **fields))


def records(plan: SweepPlan, times_s: Sequence[Sequence[float | None]]) -> dict[str, RunRecord]:
    """Records of all runs of a plan with these times to 90 %, by setting and seed."""
    given = [time_s for of_setting in times_s for time_s in of_setting]
    return {run.name: done(run.name, time_s) for run, time_s in zip(plan.runs(), given, strict=True)}


@pytest.fixture(scope="session")
def plan() -> SweepPlan:
    return make_plan(SCENARIO, SEEDS, VARY)


@pytest.fixture(scope="session")
def swept(tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    folder = tmp_path_factory.mktemp("swept") / "out"
    return sweep(SCENARIO, SEEDS, vary=VARY, output=folder, workers=2)


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing: `swept` has figures."""
    monkeypatch.setattr("robrain.lab.sweep.sweep.figure_files", lambda *_: {})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "out"
