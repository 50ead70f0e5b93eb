"""Options of the command line, and the files and names that they give."""

from pathlib import Path

import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.options import next_file
from robrain.deploy.command_line.scenario_choice import choose_scenario
from robrain.deploy.commands.team_commands import one_robot
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.coordinator_process import read_witnesses
from robrain.deploy.processes.table_files import read_planning, write_planning
from robrain.protocol.errors import RobrainError
from robrain.protocol.model.tasks.objective import Objective
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


@pytest.mark.parametrize("name", ["lab.yaml", "maps/lab.yml"])
def test_a_map_is_a_scenario(name: str) -> None:
    assert choose_scenario(name, None, 2, None, None).replace(toml="") == choose_scenario(
        None, Path(name), 2, None, None
    )
    with pytest.raises(UsageError, match=r"map\.yaml"):
        choose_scenario(None, None, None, None, None)


@pytest.mark.parametrize("near", ["9,1", "1,-4"])
def test_a_start_off_the_map_is_refused(folder: Path, near: str) -> None:
    with pytest.raises(ScenarioError, match="expected a start on the map, x from 0 to 4 m and y from 0 to 3 m; got"):
        choose_scenario("room.toml", None, None, None, None, near).world()


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
    policy = PlanningPolicy(
        objective=Objective.MAKESPAN, method="greedy", seed=7, deadline_s=0.3, reserve_share=0.25, tasks_max=12
    )
    assert read_planning(write_planning(tmp_path / "planning.toml", policy)) == policy
    assert read_planning(write_planning(tmp_path / "usual.toml", PlanningPolicy())) == PlanningPolicy()


def test_a_scenario_will_do_as_its_other_tables_are_not_looked_at(tmp_path):
    path = tmp_path / "depot.toml"
    path.write_text('[scenario]\nname = "depot"\n[planning]\nseed = 3\n')
    assert read_planning(path) == PlanningPolicy(seed=3)


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


def test_a_file_that_is_not_there_or_no_text_is_told(tmp_path):
    with pytest.raises(UsageError, match=r"team\.toml: there is no such file"):
        read_planning(tmp_path / "team.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="cannot be read"):
        read_planning(tmp_path / "bytes.toml")
    with pytest.raises(UsageError, match="cannot be read"):
        read_planning(tmp_path)


def test_a_coordinator_is_alone_without_witnesses_and_a_candidate_with_them() -> None:
    assert read_witnesses(None) == ()
    assert read_witnesses("r1,r2,r3", is_candidate=True) == ("r1", "r2", "r3")


@pytest.mark.parametrize(
    ("witnesses", "stands_by", "reason"),
    [
        (None, True, "--stand-by: expected the robots that elect as well, such as --witnesses r1,r2,r3"),
        ("r1,r2,r1", False, "--witnesses r1,r2,r1: expected each robot once, got r1 more often"),
        ("r1,,r2", False, "bad robot name '': it is empty"),
        (",".join(f"r{number}" for number in range(64)), False, "--witnesses: expected at most 63 robots, got 64"),
    ],
)
def test_a_mistake_is_refused_in_words(witnesses: str | None, stands_by: bool, reason: str) -> None:
    with pytest.raises(RobrainError) as refused:
        read_witnesses(witnesses, is_candidate=stands_by)
    assert str(refused.value) == reason


@pytest.mark.parametrize(
    ("argument", "option", "robot"), [(None, None, None), ("r1", None, "r1"), (None, "r1", "r1"), ("r1", "r1", "r1")]
)
def test_robot_is_taken_from_either(argument: str | None, option: str | None, robot: str | None) -> None:
    assert one_robot(argument, option) == robot


def test_two_robots_are_refused() -> None:
    with pytest.raises(UsageError, match="--robot r2: expected one robot, got r1 as well"):
        one_robot("r1", "r2")
