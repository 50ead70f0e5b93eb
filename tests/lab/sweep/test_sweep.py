"""A sweep in real processes: its table, its manifest and its figures, whatever happens to the processes."""

import csv
import hashlib
import multiprocessing
import shlex
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
import pytest

from robrain import Scenario
from robrain.deploy.errors import SweepError, UsageError
from robrain.lab.sweep.execution import DIED
from robrain.lab.sweep.folder import JOURNAL
from robrain.lab.sweep.plan import make_plan
from robrain.lab.sweep.sweep import SweepManifest, SweepOptions, SweepProgress, SweepResult, run_sweep, sweep
from robrain.lab.sweep.worker import RunTask, run_task
from robrain.sim.firmware.battery import SimulatedBattery
from tests.lab.sweep.conftest import SCENARIO, SEEDS, VARY

pytestmark = pytest.mark.system


def manifest_of(folder: Path) -> SweepManifest:
    return msgspec.json.decode((folder / "sweep.json").read_bytes(), type=SweepManifest)


def table_bytes(result: SweepResult) -> bytes:
    return (result.folder / "table.parquet").read_bytes()


def test_a_row_is_what_the_command_of_the_manifest_gives(swept: SweepResult, monkeypatch: pytest.MonkeyPatch) -> None:
    table = swept.table()
    assert list(zip(table["robots"], table["seed"], strict=True)) == [(r, s) for r in (1, 2) for s in SEEDS]
    assert set(table["state"]) == {"done"}
    row = table[(table["robots"] == 2) & (table["seed"] == 3)].iloc[0]
    monkeypatch.chdir(swept.folder)
    manifest = manifest_of(swept.folder)
    assert len(manifest.runs) == 6
    program, verb, file, option, seed = shlex.split(manifest.runs[5].command)
    assert (program, verb, option) == ("robrain", "run", "--seed")
    alone = Scenario.from_file(file).replace(seed=int(seed)).run()
    assert row["digest"] == manifest.runs[5].digest == alone.digest
    assert row["distance_m"] == alone.distance_m
    assert row["energy_j"] == alone.energy_j
    assert row["explored_share"] == alone.explored_fraction
    assert list(row["robot_distance_m"]) == [robot.distance_m for robot in alone.per_robot]
    assert row["explored_50_s"] == alone.explored_percent_s[50]
    assert row["invariants_broken"] == 0
    assert alone.map_accuracy is not None
    assert row["map_cells_off_share"] == alone.map_accuracy.share_off
    assert list(row["curve_t_s"]) == [time_s for time_s, _ in alone.explored_curve]


def test_the_table_is_csv_as_well_with_a_line_for_each_run(swept: SweepResult) -> None:
    rows = list(csv.DictReader((swept.folder / "runs.csv").read_text().splitlines()))
    assert [(row["setting"], row["seed"], row["state"]) for row in rows] == [
        (f"robots={robots}", str(seed), "done") for robots in (1, 2) for seed in SEEDS
    ]
    table = swept.table()
    for column in ("waiting_s", "idle_s", "overlap", "energy_j"):
        assert [float(row[column]) for row in rows] == pytest.approx(list(table[column]))
    assert {row["tasks_done"] for row in rows} == {""}  # the scenario has no tasks
    assert (table["idle_s"] + table["waiting_s"] > 0).all()


def test_the_manifest_has_versions_and_the_digests_of_all_files(swept: SweepResult) -> None:
    manifest = manifest_of(swept.folder)
    assert {"python", "robrain", "numpy", "pymunk"} <= set(manifest.versions)
    assert {str(path.relative_to(swept.folder)) for path in swept.files} == set(manifest.files)
    for name, digest in manifest.files.items():
        assert hashlib.sha256((swept.folder / name).read_bytes()).hexdigest() == digest
    for name, digest in manifest.settings.items():
        assert hashlib.sha256((swept.folder / "settings" / name).read_bytes()).hexdigest() == digest
    [session] = manifest.sessions
    assert (session.runs, session.workers) == (6, "2 processes")
    assert session.wall_time_s is not None


def test_other_parameters_in_the_same_folder_are_refused(swept: SweepResult) -> None:
    with pytest.raises(SweepError, match="seeds was 1,2,3 and is now 1,2"):
        sweep(SCENARIO, [1, 2], vary=VARY, output=swept.folder)
    with pytest.raises(SweepError, match="settings robots=1 was "):
        sweep(SCENARIO.replace(time_limit_s=5.0), SEEDS, vary=VARY, output=swept.folder)


@pytest.mark.usefixtures("without_figures")
def test_a_run_that_raises_is_a_row_with_its_error_and_the_others_go_on(folder: Path) -> None:
    result = sweep(SCENARIO, [1], vary={"robots": [1, 900]}, output=folder, workers=1)
    table = result.table()
    assert list(table["state"]) == ["done", "failed"]
    assert "900" in table["error"][1]
    assert table["digest"].isna().tolist() == [False, True]
    assert [name for name, _ in result.errors] == ["2-robots=900-seed1"]
    assert result.summary.settings[1].runs == {"failed": 1}


@pytest.mark.usefixtures("without_figures")
def test_a_process_that_dies_fails_its_own_run_only_the_next_call_repeats_it_and_one_more_runs_nothing(
    swept: SweepResult, folder: Path
) -> None:
    plan = make_plan(SCENARIO, list(reversed(SEEDS)), VARY)
    killed: list[int | None] = []

    def kill_once(progress: SweepProgress) -> None:
        if progress.last is not None and not killed:
            for child in multiprocessing.active_children():
                child.kill()
                killed.append(child.pid)

    result = run_sweep(plan, SweepOptions(output=folder, workers=2), kill_once)
    assert len(killed) == 2  # one at a run, and the one that had just ended its own
    failed = [error for _, error in result.errors]
    assert 1 <= len(failed) <= 2
    assert set(failed) == {DIED}
    assert list(result.table()["state"]).count("done") == 6 - len(failed)
    again = run_sweep(plan, SweepOptions(output=folder, workers=1))
    assert again.errors == []
    assert table_bytes(again) == table_bytes(swept)  # whatever the order of the seeds
    assert not {"wall_time_s", "real_time_factor"} & set(pq.read_schema(folder / "table.parquet").names)
    journal = (folder / JOURNAL).read_bytes()
    assert table_bytes(run_sweep(plan, SweepOptions(output=folder))) == table_bytes(swept)
    assert (folder / JOURNAL).read_bytes() == journal
    assert [session.runs for session in manifest_of(folder).sessions] == [6, len(failed), 0]


def test_figures_are_vector_graphics(swept: SweepResult) -> None:
    names = {path.name for path in swept.files if path.parent.name == "figures"}
    stems = {"explored", "measures", "differences"}
    assert names == {f"{stem}.{form}" for stem in stems for form in ("svg", "pdf")}
    assert all((swept.folder / "figures" / f"{stem}.pdf").read_bytes().startswith(b"%PDF") for stem in stems)
    assert all(b"</svg>" in (swept.folder / "figures" / f"{stem}.svg").read_bytes() for stem in stems)


def test_wrong_workers_are_refused_before_anything_is_written(folder: Path) -> None:
    with pytest.raises(UsageError, match="--workers 0: expected at least 1"):
        sweep(SCENARIO, [1], output=folder, workers=0)
    assert not folder.exists()


def test_one_seed_and_one_setting_make_a_sweep_with_a_recording(folder: Path) -> None:
    result = sweep(SCENARIO, [7], output=folder, workers=1, record=True)
    assert len(result.table()) == 1
    assert result.summary.comparisons == []
    assert [path.name for path in result.files if path.suffix == ".svg"] == ["explored.svg"]
    [run] = manifest_of(folder).runs
    assert run.recording is not None
    assert (folder / run.recording).stat().st_size > 1000


@pytest.mark.slow
def test_broken_invariants_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    step = SimulatedBattery.step

    def leaks(battery: SimulatedBattery, *given: float) -> None:
        step(battery, *given)
        battery.delivered_j -= 20.0

    monkeypatch.setattr(SimulatedBattery, "step", leaks)
    toml = SCENARIO.replace(time_limit_s=3.0, motes=0).to_toml()
    record = run_task(RunTask(run="one", seed=2, toml=toml))
    assert record.outcome is not None, record.error
    assert record.outcome.invariants_broken == 1
