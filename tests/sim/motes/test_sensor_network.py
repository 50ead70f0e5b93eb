"""The tables [motes], [radio] and [field] of a scenario."""

from robrain import Scenario
from robrain.sim.motes.mote import MoteSpec
from robrain.sim.motes.radio import RadioModel

FLOOR = '[scenario]\nname = "s"\n[floor]\nsize_m = [6.0, 6.0]\n[team]\nrobots = 1\n'
TABLES = """
[motes]
count = 3
period_s = 1.0
quantities = ["light", "humidity"]
[radio]
shadowing_db = 0.0
[field]
plumes = 1
light = { base = 100.0, plume = 0.0, noise = 0.0 }
"""


def scenario(tmp_path, tables):
    path = tmp_path / "s.toml"
    path.write_text(FLOOR + tables)
    return Scenario.from_file(path)


def test_what_a_scenario_says_of_motes_radio_and_field_is_what_is_simulated(tmp_path):
    found = scenario(tmp_path, TABLES)
    assert found.motes == 3
    assert found.network.motes == MoteSpec(period_s=1.0, quantities=("light", "humidity"))
    assert found.network.radio == RadioModel(shadowing_db=0.0)
    assert (found.network.field.plumes, found.network.field.light.base) == (1, 100.0)
    assert found.world().network == found.network
