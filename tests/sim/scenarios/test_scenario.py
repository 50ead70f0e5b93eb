from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robrain import Scenario
from robrain.sim.errors import ScenarioError

ROOT = Path(__file__).parents[3]
SMALL = Scenario.builtin("arena_small")


def test_a_map_that_is_missing_is_named(tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text('[scenario]\nname = "s"\n[map]\nfile = "maps/office.yaml"\n')
    scenario = Scenario.from_file(path)
    for use in (scenario.plan, scenario.world, scenario.run):
        with pytest.raises(ScenarioError) as error:
            use()
        assert str(tmp_path / "maps" / "office.yaml") in str(error.value)
        assert "\n" not in str(error.value)


def test_a_map_is_looked_for_beside_its_scenario_file(tmp_path: Path, monkeypatch):
    (tmp_path / "maps").mkdir()
    picture = np.zeros((40, 60), np.uint8)
    picture[2:-2, 2:-2] = 254
    Image.fromarray(picture).save(tmp_path / "maps" / "office.png")
    (tmp_path / "maps" / "office.yaml").write_text(
        "image: office.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    (tmp_path / "mine.toml").write_text('[scenario]\nname = "s"\n[map]\nfile = "maps/office.yaml"\n')
    monkeypatch.chdir("/")
    assert Scenario.from_file(tmp_path / "mine.toml").plan().size_m == (6.0, 4.0)
    scenario = Scenario.from_map(tmp_path / "maps" / "office.yaml", robots=2, motes=3)
    world = scenario.world()
    assert (scenario.name, len(world.robots), len(world.motes)) == ("office", 2, 3)


@pytest.mark.slow
def test_figures_of_the_robots_add_up_to_those_of_the_team():
    result = SMALL.run(time_limit_s=5.0, until_explored=1.0)
    assert [robot.name for robot in result.per_robot] == ["r1", "r2"]
    assert result.distance_m == pytest.approx(sum(robot.distance_m for robot in result.per_robot))
    assert result.energy_j == pytest.approx(sum(robot.energy_j for robot in result.per_robot))
    assert result.distance_m > 1.0
    # Two robots that idle draw 8 W each.
    assert result.energy_j > 2 * 8.0 * 5.0
    assert result.mote_readings > 0
