"""The mapping benchmark: which runs its options ask for, what it tells of them, and what it refuses."""

import json
from pathlib import Path

import msgspec
import pytest

from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import BenchReport
from robrain.lab.bench.mapping import HEADINGS, MappedRun, figures, mapped, run_bench, run_case
from robrain.lab.bench.mapping_plan import OWN_MAPS, BenchPlan, Case, choose
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy

CLINIC = OWN_MAPS / "clinic.yaml"
SMALL = Case(map="arena_small", path="", robots=1, seed=3, wheels="exact", time_limit_s=2.0)


def chosen(**options: object) -> BenchPlan[Case]:
    words = {"maps": "clinic", "robots": "4", "seeds": "1", "wheels": "exact", "jobs": 1, "time_limit_s": 60.0}
    return choose(**(words | options))


def run_of(**facts: object) -> MappedRun:
    case = msgspec.structs.replace(SMALL, wheels=facts.pop("wheels", "exact"), seed=facts.pop("seed", 1))
    return MappedRun(case=case, ended="explored", **facts)


def test_every_map_comes_with_every_team_seed_and_kind_of_wheels() -> None:
    plan = chosen(maps="clinic,arena_small", robots="1,2-3", seeds="7,1-2", wheels="exact,slipping")
    asked = [(case.map, case.robots, case.seed, case.wheels) for case in plan.cases]
    assert len(asked) == len(set(asked)) == 2 * 3 * 3 * 2
    assert {case.path for case in plan.cases} == {str(CLINIC), ""}
    assert asked[0] == ("clinic", 1, 7, "exact")


def test_by_default_all_maps_that_are_there_are_taken_and_the_others_named(tmp_path: Path) -> None:
    (tmp_path / "stage_cave.yaml").write_text("", encoding="utf-8")
    plan = chosen(maps=None, map_folder=tmp_path)
    with pytest.raises(UsageError, match="nav2_depot: it is not on this computer, see --map-folder"):
        chosen(maps="nav2_depot", map_folder=tmp_path)
    taken = {case.map for case in plan.cases}
    assert taken >= {path.stem for path in OWN_MAPS.glob("*.yaml")} | {"stage_cave", "depot", "arena_small"}
    assert set(plan.absent) == {"stage_hospital_section", "stage_autolab", "nav2_depot"}
    assert not taken & set(plan.absent)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"maps": "moon"}, "--maps moon: there is no such map; expected a map.yaml or one of "),
        ({"map_folder": Path("nowhere")}, "--map-folder nowhere: expected an existing folder"),
        ({"robots": "0"}, "--robots 0: expected numbers from 1 to 1000, got '0'"),
        ({"robots": "4-2"}, "--robots 4-2: expected numbers from 1 to 1000, got '4-2'"),
        ({"robots": "two"}, "--robots two: expected whole numbers such as 1,2 or 1-4, got 'two'"),
        ({"seeds": "0-1000000000000"}, "--seeds 0-1000000000000: expected at most 1000 numbers"),
        ({"wheels": "round"}, "--wheels round: expected exact or slipping"),
        ({"conditions": "usual,fog"}, "--conditions fog: expected usual or glass or late"),
        ({"jobs": 0}, "--jobs 0: expected at least 1"),
        ({"time_limit_s": float("nan")}, "--time-limit-s nan: expected a number above 0"),
    ],
)
def test_bad_options_are_refused_in_a_sentence(options: dict[str, object], told: str) -> None:
    with pytest.raises(UsageError) as error:
        chosen(**options)
    assert str(error.value).startswith(told)


def test_late_runs_are_compared_with_the_same_runs_in_time() -> None:
    late = msgspec.structs.replace(run_of(seed=1, share_off=0.05).case, conditions="late")
    other = msgspec.structs.replace(late, seed=9)  # never made in time: nothing to compare with
    runs = [
        run_of(seed=1, share_off=0.01),
        MappedRun(case=late, ended="explored", share_off=0.05),
        MappedRun(case=other, ended="explored", share_off=0.09),
    ]
    found = {figure.name: figure for figure in figures(runs)}
    worse = found["exact wheels, late: occupied cells off, more than usual, worst run"]
    assert worse.value == pytest.approx(4.0)
    assert (worse.kept, worse.beside) == (False, "arena_small, 1 robots, seed 1")
    assert found["exact wheels, late: occupied cells off, worst run"].value == pytest.approx(9.0)
    assert found["exact wheels: occupied cells off, worst run"].value == pytest.approx(1.0)


@pytest.mark.slow
def test_run_tells_the_worst_robot_and_all_robots_samples() -> None:
    result = SMALL.scenario().replace(robots=2).run(time_limit_s=0.2)
    near = PoseAccuracy(samples=10, rmse_m=0.1, max_error_m=0.9, nees=1.0, nees_in_band=1.0, lost_s=2.0, is_lost=True)
    far = PoseAccuracy(
        samples=30, rmse_m=0.3, max_error_m=0.4, nees=3.0, nees_in_band=0.6, longest_silent_divergence_s=1.5
    )
    robots = [
        msgspec.structs.replace(robot, pose_accuracy=accuracy)
        for robot, accuracy in zip(result.per_robot, (near, far), strict=True)
    ]
    of_map = MapAccuracy(occupied_cells=200, cells_off=5, share_off=0.025, doubled_walls_m=0.25)
    run = mapped(SMALL, msgspec.structs.replace(result, per_robot=robots, map_accuracy=of_map))
    assert (run.rmse_m, run.max_error_m, run.longest_silent_divergence_s, run.lost, run.lost_s) == (
        0.3,
        0.9,
        1.5,
        1,
        2.0,
    )
    assert run.nees == pytest.approx(2.5)
    assert run.nees_in_band == pytest.approx(0.7)
    assert (run.share_off, run.doubled_walls_m) == (0.025, 0.25)
    cells = run.line().split()
    assert cells[:4] == ["arena_small", "1", "3", "exact"]
    assert cells[-7:-1] == ["0.2", "0.300", "0.90", "1.5", "70.0", "1"]
    assert len(HEADINGS) == len(run.line())


def test_what_cannot_be_run_says_why_and_counts_in_no_figure() -> None:
    run = run_case(msgspec.structs.replace(SMALL, robots=1000))
    assert "robots" in run.refusal
    assert "not run: " in run.line()
    assert list(figures([run])) == []


def test_figures_are_worst_and_median_beside_their_bounds() -> None:
    runs = [
        run_of(seed=1, share_off=0.01, rmse_m=0.1, nees_in_band=1.0, longest_silent_divergence_s=4.9),
        run_of(seed=2, share_off=0.04, rmse_m=0.2, nees_in_band=0.9, longest_silent_divergence_s=5.0),
        run_of(seed=3, share_off=0.011, rmse_m=0.11, nees_in_band=0.97),
        run_of(wheels="slipping", share_off=0.025, doubled_walls_m=3.5, lost=2),
    ]
    found = {figure.name: figure for figure in figures(runs)}
    worst = found["exact wheels: occupied cells off, worst run"]
    assert (worst.value, worst.kept, worst.beside) == (4.0, False, "arena_small, 1 robots, seed 2")
    assert found["exact wheels: occupied cells off, median"].value == pytest.approx(1.1)
    assert found["exact wheels: occupied cells off, median"].kept
    assert found["exact wheels: position RMSE, worst robot"].kept is False
    assert found["exact wheels: position RMSE, worst robot, median run"].value == 0.11
    assert found["exact wheels: silent divergence, longest"].kept is False  # below 5 s, not at most
    share = found["exact wheels: NEES within its 95 % bound, worst run"]
    assert (share.value, share.kept) == (90.0, False)
    assert found["slipping wheels: occupied cells off, worst run"].kept  # 3 % are allowed there
    assert found["slipping wheels: doubled walls, worst run"].value == 3.5
    assert found["slipping wheels: robots lost at the end"].value == 2


@pytest.mark.slow
def test_runs_are_printed_and_written_and_equal_in_processes_of_their_own(tmp_path: Path, capsys) -> None:
    with pytest.raises(FileNotFoundError):  # before the first run
        run_bench(BenchPlan(cases=[SMALL], jobs=1, absent=[]), tmp_path / "none" / "told.json")
    assert "arena_small" not in capsys.readouterr().out
    file = tmp_path / "told.json"
    plan = BenchPlan(cases=[SMALL, msgspec.structs.replace(SMALL, wheels="slipping")], jobs=1, absent=["attic"])
    run_bench(plan, file)
    printed, said = capsys.readouterr()
    assert [line.split()[3] for line in printed.splitlines()[:3]] == ["wheels", "exact", "slipping"]
    assert "occupied cells off" in printed
    assert "attic: left out" in said
    alone = msgspec.json.decode(file.read_bytes(), type=BenchReport[MappedRun])
    assert [run.case for run in alone.runs] == plan.cases
    assert alone.all_kept == all(figure["kept"] is not False for figure in json.loads(file.read_bytes())["figures"])
    run_bench(msgspec.structs.replace(plan, jobs=2), file)
    beside = msgspec.json.decode(file.read_bytes(), type=BenchReport[MappedRun])
    for run, other in zip(alone.runs, beside.runs, strict=True):
        assert msgspec.structs.replace(run, wall_time_s=0.0) == msgspec.structs.replace(other, wall_time_s=0.0)
    assert alone.runs[0].rmse_m > 0
