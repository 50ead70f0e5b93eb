from pathlib import Path

import pytest

from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario_file import builtin_names, read_builtin, read_scenario_file

FLOOR = "[floor]\nsize_m = [4.0, 3.0]\n"
GOOD = f'[scenario]\nname = "s"\n{FLOOR}'

PLACE = "place_m = [1.0, 1.0]"


def fault(kind: str, *more: str) -> str:
    """A scenario with one fault, of robot r1 after a second."""
    return "\n".join((f'{GOOD}[[faults]]\nrobot = "r1"\nkind = "{kind}"\nat_s = 1.0', *more)) + "\n"


# What is wrong, the text, the key that must be named, what was expected.
WRONG = {
    "no TOML": ("[scenario\n", "", "is not TOML"),
    "empty": ("", "", "missing required field `scenario`"),
    "no name": (f"[scenario]\n{FLOOR}", "scenario", "missing required field `name`"),
    "unknown table": (f"{GOOD}[robot_team]\ncount = 3\n", "", "unknown table `robot_team`"),
    "unknown key": (GOOD + "[team]\nrobot = 3\n", "team", "`robot` (did you mean `robots`?); there are idle, near_m,"),
    "unknown key of the floor": (f"{GOOD}colour = 3\n", "floor", "unknown key `colour`; there are blocks, pillars,"),
    "neither floor nor map": ('[scenario]\nname = "s"\n', "", "either [floor] or [map]"),
    "floor and map": (f'{GOOD}[map]\nfile = "map.yaml"\n', "", "either [floor] or [map]"),
    "no robots": (GOOD + "[team]\nrobots = 0\n", "team", "expected robots"),
    "starts near and scattered": (f'{GOOD}[team]\nstarts = "scattered"\nnear_m = [1, 1]\n', "team", "got both"),
    "carried to nowhere": (fault("carried_off"), "faults[0]", "expected place_m for carried_off"),
    "a place for a bus": (fault("can_cut", PLACE), "faults[0]", "for nothing else"),
    "carried back": (fault("carried_off", PLACE, "until_s = 2.0"), "faults[0]", "expected no until_s"),
    "a floor without size": (GOOD.replace("4.0", "0.0"), "floor", "size_m"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "key", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_scenario_is_told_in_one_sentence_with_file_and_key(tmp_path: Path, text, key, expected):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        read_scenario_file(path)
    said = str(error.value)
    assert said.startswith(f"{path}: {key}")
    assert expected in said
    assert "\n" not in said


def test_a_file_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ScenarioError, match=r"nothing\.toml: no such scenario file"):
        read_scenario_file(tmp_path / "nothing.toml")


def test_a_folder_and_a_file_of_other_bytes_are_no_scenarios(tmp_path: Path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_scenario_file(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"bytes\.toml: cannot be read"):
        read_scenario_file(tmp_path / "bytes.toml")


@pytest.mark.parametrize("name", builtin_names())
def test_each_built_in_scenario_bears_the_name_of_its_file(name):
    tables, text = read_builtin(name)
    assert tables.scenario.name == name
    assert name in text


def test_an_unknown_name_is_answered_with_those_that_there_are():
    with pytest.raises(ScenarioError, match="no scenario 'depo': built in are arena_small, cave, depot, hospital"):
        read_builtin("depo")
