"""The table `[links]`: what robots are told of it, and what is refused in words."""

import re
from pathlib import Path

import pytest

from robrain.sim.scenarios.scenario import Scenario
from tests.sim.links.radio_team import corridor


def test_robots_are_told_to_wait_at_their_start_if_they_know_it_and_are_to_return():
    def idle(lines, **changes):
        world = corridor(lines, robots=2).replace(**changes).world()
        return world.robots[1].start, world.robot_file(world.robots[1]).parameters.get("idle")

    start, parameters = idle("return_after_s = 5.0")
    assert parameters == {"home": [start.x_m, start.y_m], "return_after_s": 5.0}
    assert idle("return_after_s = inf")[1] is None
    assert idle("", starts_known=False)[1] is None
    assert idle("", links=None)[1] is None


ROOT = Path(__file__).parents[3]


@pytest.mark.slow
def test_scenario_of_the_documentation_runs(tmp_path):
    page = (ROOT / "docs" / "how-to" / "simulated-radio.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "radio.toml").write_text(
        text.replace("office_ring.yaml", str(ROOT / "examples" / "maps" / "office_ring.yaml"))
    )
    result = Scenario.from_file(tmp_path / "radio.toml").run(time_limit_s=1.0)
    assert result.links is not None
    assert result.links.delivered > 0
