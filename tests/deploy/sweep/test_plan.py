"""The plan of a sweep: all combinations, each a scenario file of its own."""

from pathlib import Path

import pytest

from robrain import Scenario, ScenarioError
from robrain.deploy.errors import UsageError
from robrain.deploy.sweep.plan import make_plan
from robrain.sim.scenarios.scenario_document import document_toml, scenario_document

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


def test_a_setting_is_the_scenario_with_its_values() -> None:
    [_, two] = make_plan(DEPOT, [1], {"team.robots": [1, 2]}).settings
    assert scenario_document(Scenario.from_toml(two.toml)) == scenario_document(DEPOT.replace(robots=2))
    assert two.values == {"robots": 2}


@pytest.mark.parametrize("name", ["arena_small", "depot"])
def test_a_scenario_survives_its_own_document(name: str) -> None:
    scenario = Scenario.builtin(name)
    again = Scenario.from_toml(document_toml(scenario_document(scenario)))
    assert again.replace(toml="") == scenario.replace(toml="")


def test_without_keys_there_is_one_setting() -> None:
    [setting] = make_plan(DEPOT, [1], {}).settings
    assert (setting.label, setting.values) == ("depot", {})


def test_a_map_can_be_varied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    plan = make_plan(DEPOT.replace(chargers=()), [1], {"map": ["examples/maps/clinic.yaml"]})
    [setting] = plan.settings
    assert setting.values == {"map": "examples/maps/clinic.yaml"}
    assert Scenario.from_toml(setting.toml, base=tmp_path).floor == CLINIC.resolve()
    assert list(plan.floors) == [str(CLINIC.resolve())]


@pytest.mark.parametrize(
    ("vary", "why"),
    [
        ({"robots": ["two"]}, r"--vary robots=two: team.robots: Expected `int`"),
        ({"robots": [0]}, "--vary robots=0: team: expected robots from 1 to 1000"),
        ({"strategy": ["jiont"]}, "did you mean joint"),
        ({"map": ["nix.yaml"]}, "--vary map=nix.yaml: .*nix.yaml: expected a map_server YAML file"),
        ({"robots": [2, 2]}, "--vary robots: expected each value once, got 2, 2"),
        ({"until": [0.9, 2]}, "until_explored above 0 and at most 1"),
        ({"robots": [1], "team.robots": [2]}, "expected each key once"),
    ],
)
def test_a_wrong_value_is_told_with_its_key(vary: dict[str, list[object]], why: str) -> None:
    with pytest.raises(UsageError, match=why):
        make_plan(DEPOT, [1], vary)


def test_more_runs_than_the_limit_are_refused_with_their_number() -> None:
    with pytest.raises(UsageError, match=r"--limit 5: these are 6 runs \(2 settings × 3 seeds\)"):
        make_plan(DEPOT, [1, 2, 3], {"robots": [1, 2]}, limit=5)
    assert len(make_plan(DEPOT, [1, 2, 3], {"robots": [1, 2]}, limit=6).runs()) == 6


def test_a_floor_is_known_by_its_cells() -> None:
    [(drawing, cells)] = make_plan(DEPOT, [1], {"robots": [1, 2]}).floors.items()
    coarse = make_plan(DEPOT, [1], {"floor.resolution_m": [0.1]}).floors
    assert drawing not in coarse
    assert cells not in coarse.values()


def test_text_that_is_no_scenario_is_told_with_its_name() -> None:
    with pytest.raises(ScenarioError, match=r"mine: team\.robots: Expected `int`"):
        Scenario.from_toml('[scenario]\nname = "a"\n[floor]\nsize_m = [2, 2]\n[team]\nrobots = "x"\n', "mine")
