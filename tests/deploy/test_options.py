"""Options of the command line, and the files and names that they give."""

from pathlib import Path

import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.options import next_file
from robrain.deploy.command_line.scenario_choice import choose_scenario
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.coordinator_process import read_witnesses
from robrain.deploy.processes.table_files import read_planning, write_planning
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.zone import ZoneKind, ZoneTable
from robrain.sim.errors import ScenarioError

ROOM = """
[scenario]
name = "room"
[floor]
size_m = [4, 3]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.toml").write_text(ROOM)
    (tmp_path / "mine.py").write_text("def choose(situation):\n    return []\n\n\nclass Mine:\n    pass\n")
    return tmp_path


@pytest.mark.parametrize("near", ["9,1", "1,-4"])
def test_a_start_off_the_map_is_refused(folder: Path, near: str) -> None:
    with pytest.raises(ScenarioError, match="expected a start on the map, x from 0 to 4 m and y from 0 to 3 m; got"):
        choose_scenario("room.toml", None, None, None, None, near).world()


@pytest.mark.parametrize(
    ("name", "map_file", "floor", "known_floor"),
    [
        ("room.toml", None, "drawn", True),
        ("room.toml", "run.mcap", "drawn", Path("run.mcap")),
        (None, "lab.yaml", Path("lab.yaml"), Path("lab.yaml")),
    ],
)
def test_team_knows_its_floor_or_the_given_map(
    folder: Path, name: str | None, map_file: str | None, floor: object, known_floor: object
) -> None:
    chosen = choose_scenario(name, map_file and Path(map_file), None, None, None, known=True)
    assert chosen.known_floor == known_floor
    assert (chosen.floor if isinstance(chosen.floor, Path) else "drawn") == floor


def test_a_recording_is_no_floor_to_simulate(folder: Path) -> None:
    with pytest.raises(UsageError, match=r"--map run\.mcap: expected a SCENARIO"):
        choose_scenario(None, Path("run.mcap"), None, None, None, known=True)


@pytest.mark.parametrize(
    ("strategy", "method"), [("nearest", "auction"), ("mine.py:choose", None), (None, "mine.py:Mine")]
)
def test_a_strategy_and_an_allocator_are_chosen_by_name_or_file(
    folder: Path, strategy: str | None, method: str | None
) -> None:
    planning = choose_scenario("room.toml", None, None, None, None, strategy=strategy, method=method).planning
    assert planning.exploration.removeprefix(f"{folder}/") == (strategy or "auto")
    assert planning.method.removeprefix(f"{folder}/") == (method or "optimal")


@pytest.mark.parametrize(
    ("option", "name", "why"),
    [
        ("strategy", "nearst", "did you mean nearest"),
        ("strategy", "mine.py", "or FILE.py:NAME; got mine.py"),
        ("strategy", "mine.py:absent", "mine.py has no function absent"),
        ("method", "other.py:Mine", "there is no file .*other.py"),
    ],
)
def test_a_part_that_there_is_not_is_refused_with_its_option(folder: Path, option: str, name: str, why: str) -> None:
    with pytest.raises(UsageError, match=f"--{option} {name}: .*{why}"):
        choose_scenario("room.toml", None, None, None, None, **{option: name})


@pytest.mark.parametrize(
    ("there", "expected"),
    [
        ((), "team-1.mcap"),
        (("team-1.mcap", "team-3.mcap"), "team-4.mcap"),
        (("team-1_0002.mcap", "team-1_0020.mcap"), "team-2.mcap"),
        (("other-7.mcap", "team-x.mcap", "team-2.txt"), "team-1.mcap"),
    ],
)
def test_a_recording_has_a_number_that_no_part_of_another_has(tmp_path, there, expected):
    """Rotation may have removed the first part of one."""
    for name in there:
        (tmp_path / name).touch()
    assert next_file(tmp_path, "team").name == expected


def test_what_is_written_is_read(tmp_path):
    lane = ZoneTable(name="lane", kind=ZoneKind.RESERVED, corners_m=((0.0, 0.0), (2.0, 0.0), (2.0, 1.0)))
    policy = PlanningPolicy(
        objective=Objective.MAKESPAN,
        method="greedy",
        seed=7,
        deadline_s=0.3,
        reserve_share=0.25,
        tasks_max=12,
        zones=(lane,),
    )
    assert read_planning(write_planning(tmp_path / "planning.toml", policy)) == policy
    assert read_planning(write_planning(tmp_path / "usual.toml", PlanningPolicy())) == PlanningPolicy()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[planning]\nseed = -1\n", ["planning", "seed >= 0", "-1"]),  # out of range
        (
            '[planning]\nmethod = "best"\n',
            ["planning: expected method to be one of", "got best"],
        ),  # none of the methods
        ('[planning]\ndeadline_s = "long"\n', ["planning.deadline_s", "float", "str"]),  # another type
        ("[planning]\nsead = 1\n", ["planning", "sead"]),  # misspelt key
        ("[planing]\nseed = 1\n", ["[planning]"]),  # misspelt table
        ("[planning\n", ["not TOML"]),
        ("", ["[planning]"]),
    ],
)
def test_a_wrong_file_is_told_in_one_sentence_with_its_name_and_key(tmp_path, text, named):
    path = tmp_path / "team.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as raised:
        read_planning(path)
    assert all(word in str(raised.value) for word in ["--planning", str(path), *named])
    assert "\n" not in str(raised.value)


def test_a_coordinator_is_alone_without_witnesses_and_a_candidate_with_them() -> None:
    assert read_witnesses(None) == ()
    assert read_witnesses("r1,r2,r3", is_candidate=True) == ("r1", "r2", "r3")
