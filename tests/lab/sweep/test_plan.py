"""The plan of a sweep: all combinations, each a scenario file of its own."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain import Scenario
from robrain.deploy.errors import UsageError
from robrain.lab.sweep.plan import make_plan, value_at, with_values
from robrain.protocol.toml_text import toml_of
from robrain.sim.scenarios.scenario_file import builtin_folder, builtin_names

ROOT = Path(__file__).parents[3]
DEPOT = Scenario.builtin("depot")
CLINIC = ROOT / "examples" / "maps" / "clinic.yaml"


def test_every_combination_runs_with_every_seed() -> None:
    plan = make_plan(DEPOT, [3, 1], {"robots": [1, 2], "strategy": ["joint", "nearest"]})
    assert [setting.values for setting in plan.settings] == [
        {"robots": 1, "strategy": "joint"},
        {"robots": 1, "strategy": "nearest"},
        {"robots": 2, "strategy": "joint"},
        {"robots": 2, "strategy": "nearest"},
    ]
    runs = plan.runs()
    assert [(run.setting, run.seed) for run in runs] == [(k, seed) for k in range(4) for seed in (1, 3)]
    assert len({run.name for run in runs}) == 8
    assert runs[3].name == "2-robots=1,strategy=nearest-seed3"


@pytest.mark.parametrize("name", builtin_names())
def test_a_scenario_survives_its_own_document(name: str) -> None:
    scenario = Scenario.builtin(name)
    again = Scenario.from_toml(toml_of(scenario.document()), base=builtin_folder())
    assert again.document() == scenario.document()


def test_a_map_can_be_varied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    plan = make_plan(DEPOT.replace(chargers=()), [1], {"map": ["examples/maps/clinic.yaml"]})
    [setting] = plan.settings
    assert setting.values == {"map": "examples/maps/clinic.yaml"}
    assert Scenario.from_toml(setting.toml, base=tmp_path).floor == CLINIC.resolve()
    assert list(plan.inputs) == [str(CLINIC.resolve())]


@pytest.mark.parametrize(
    ("vary", "why"),
    [
        ({"robots": ["two"]}, r"--vary robots=two: team.robots: Expected `int`"),
        ({"strategy": ["jiont"]}, "did you mean joint"),
        ({"map": ["nix.yaml"]}, "--vary map=nix.yaml: .*nix.yaml: expected a map_server YAML file"),
        ({"robots": [2, 2]}, "--vary robots: expected each value once, got 2, 2"),
        ({"robots": [1], "team.robots": [2]}, "expected each key once"),
    ],
)
def test_a_wrong_value_is_told_with_its_key(vary: dict[str, list[object]], why: str) -> None:
    with pytest.raises(UsageError, match=why):
        make_plan(DEPOT, [1], vary)


def test_more_runs_than_the_limit_are_refused_with_their_number() -> None:
    with pytest.raises(UsageError, match=r"--limit 5: got 6 runs \(2 settings × 3 seeds\)"):
        make_plan(DEPOT, [1, 2, 3], {"robots": [1, 2]}, limit=5)
    assert len(make_plan(DEPOT, [1, 2, 3], {"robots": [1, 2]}, limit=6).runs()) == 6


FULL = """
[scenario]
name = "full"
[floor]
size_m = [8, 6]
walls = [{ from_m = [5, 0], to_m = [5, 2] }]
blocks = [{ x_m = 1, y_m = 4, width_m = 1, height_m = 1 }]
pillars = [{ x_m = 6, y_m = 2, radius_m = 0.3 }]
[[tasks]]
kind = "visit"
place_m = [2, 2]
[[chargers]]
place_m = [1, 1]
[[robots]]
type = "scout"
"""


ROOM = Scenario.from_toml(FULL, "full")


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("links.range_m", [6.0, 12.0]),
        ("tasks.0.priority", [1.0, 5.0]),
        ("robots.0.type", ["scout", "carrier"]),
        ("planning.passes", [["stability"], ["early_start"]]),
        ("disturbance.scan.late_s", [[0.0, 0.0], [0.1, 0.2]]),
    ],
)
def test_a_key_of_a_table_that_the_scenario_has_not_can_be_varied(key: str, values: list[Any]) -> None:
    plan = make_plan(ROOM, [1], {key: values})
    settings = [Scenario.from_toml(setting.toml).document() for setting in plan.settings]
    assert [msgspec.json.encode(value_at(found, key)) for found in settings] == [
        msgspec.json.encode(value_at(with_values(found, {key: value}), key))
        for found, value in zip(settings, values, strict=True)
    ]
    assert len(plan.settings) == len(values)


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("links.rang_m", r"links: unknown key `rang_m` \(did you mean `range_m`\?\)"),
        ("tasks.3.priority", "expected a number below 1 where 3 is"),
        ("scenario.time_limit_s.x", "expected no more keys where x is"),
    ],
)
def test_a_key_that_a_scenario_cannot_have_is_refused(key: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        make_plan(ROOM, [1], {key: [1.0]})


def test_a_sweep_keeps_rules_and_radio_of_its_scenario() -> None:
    for name in ("plume", "relay_chain", "no_centre"):
        scenario = Scenario.builtin(name)
        [setting] = make_plan(scenario, [1], {"time_limit": [20.0]}).settings
        again = Scenario.from_toml(setting.toml)
        assert (again.links, again.rules) == (scenario.links, scenario.rules)


def test_a_strategy_of_a_file_is_an_input_of_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text("from robrain.algorithms.exploration.strategies import joint as choose\n")
    first = make_plan(ROOM, [1], {"strategy": ["joint", "mine.py:choose"]})
    assert [setting.label for setting in first.settings] == ["strategy=joint", "strategy=mine.py:choose"]
    assert Scenario.from_toml(first.settings[1].toml).planning.exploration == f"{tmp_path}/mine.py:choose"
    Path("mine.py").write_text("from robrain.algorithms.exploration.strategies import nearest as choose\n")
    assert make_plan(ROOM, [1], {"strategy": ["joint", "mine.py:choose"]}).inputs != first.inputs
    with pytest.raises(UsageError, match=r"--vary strategy=mine.py:absent: .*mine.py has no function absent"):
        make_plan(ROOM, [1], {"strategy": ["mine.py:absent"]})
