"""A table of another distribution in a scenario file: converted, checked, varied, and built in a run."""

import pytest

from robrain import Scenario
from robrain.lab.sweep.plan import make_plan
from robrain.protocol.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios import scenario_file
from robrain.sim.world.arena import Arena
from tests.installed_distributions import as_new, install  # noqa: F401 - a fixture

LAMPS = """
from typing import Annotated

from msgspec import Meta

from robrain.sim.world.world import AddedTable

steps = []


class Lamp(AddedTable, frozen=True, kw_only=True):
    power_w: Annotated[float, Meta(gt=0, le=100)]
    place_m: tuple[float, float] = (0.0, 0.0)

    def build(self, world, wire):
        return lambda now_ns: steps.append((len(world.robots), self.power_w, now_ns))
"""
ROOM = 'scenario.name = "room"\nfloor.size_m = [8.0, 6.0]\nteam.robots = 2\n'
pytestmark = pytest.mark.usefixtures("lamps")
ONE, TWO = "[lamps]\npower_w = 4\n", "[[lamps]]\npower_w = 4\n[[lamps]]\npower_w = 5\n"


@pytest.fixture
def lamps(monkeypatch, install):  # noqa: F811
    as_new(scenario_file.SCENARIO_TABLES, monkeypatch)
    install("lamps", {"lamps": "lamps:Lamp"}, {"lamps.py": LAMPS}, scenario_file.SCENARIO_TABLES.group)
    scenario_file.tables_type.cache_clear()
    yield
    scenario_file.tables_type.cache_clear()


@pytest.mark.parametrize(("text", "powers"), [(ONE, [4.0]), (TWO, [4.0, 5.0]), ("", [])])
def test_one_or_several_tables_are_built_and_called_in_each_tick(text, powers):
    scenario = Scenario.from_toml(ROOM + text)
    with open_lockstep_session() as session:
        arena = Arena(scenario.world(), Endpoint(session, "default", VirtualClock(), Drive.LOCKSTEP))
        arena.step()
        arena.step()
        arena.close()
    if powers:
        from lamps import steps

        assert steps == [(2, power, now_ns) for now_ns in (20_000_000, 40_000_000) for power in powers]


def test_key_of_a_table_is_varied_and_written():
    scenario = Scenario.from_toml(ROOM + ONE)
    settings = make_plan(scenario, [1], {"lamps.power_w": [1.0, 2.5]}).settings
    assert [Scenario.from_toml(setting.toml).added["lamps"].power_w for setting in settings] == [1.0, 2.5]
    several = scenario.replace(added=Scenario.from_toml(ROOM + TWO).added)
    assert Scenario.from_toml(several.to_toml()).added == several.added


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("[lamps]\npower_w = 0\n", r"mine.toml: lamps: expected power_w > 0, got 0"),
        ("[[lamps]]\npower_w = 4\n[[lamps]]\npower_w = true\n", r"mine.toml: lamps\[1\].power_w"),
        ("[lamps]\npower = 4\n", r"mine.toml: lamps: unknown key `power`"),
        ("[lamp]\npower_w = 4\n", r"mine.toml: unknown table `lamp` \(did you mean `lamps`\?\)"),
    ],
)
def test_error_names_file_and_key(text, error):
    with pytest.raises(ScenarioError, match=error):
        Scenario.from_toml(ROOM + text, "mine.toml")
