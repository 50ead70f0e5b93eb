"""The scenario that a command line names."""

from pathlib import Path

import pytest

from robrain.deploy.command_line.scenario_choice import choose_scenario
from robrain.deploy.errors import UsageError
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
