"""Robots' base stations among simulated motes, on one air: visits, duty, and what two robots make of the same motes."""

import numpy as np
import pytest

from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.model.geometry import Point2D
from robrain.sim.motes.field import FieldSpec, SimulatedField
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.motes.motes import MoteField, SensorNetwork
from robrain.sim.motes.radio import RadioModel

TICK_S = 0.02
FAR = Point2D(500.0, 0.0)


class Air:
    """Motes in a row, 2 m from each other, and robots that stand where the test puts them."""

    def __init__(self, one, *, motes=1, robots=1, network=None, **parameters):
        self.one = one
        self.places = [FAR] * robots
        names = [f"r{number}" for number in range(1, robots + 1)]
        for name in names:
            one.host("snw_exploration", robot=name, snw_exploration=parameters)
        self._readings = one.inbox(MOTE_READING)
        network = network or SensorNetwork(radio=RadioModel())
        specs = [ArenaMote(name=f"m{n}", number=n, place=Point2D(2.0 * n, 0.0)) for n in range(1, motes + 1)]
        field = SimulatedField(FieldSpec(), [], Point2D(0.0, 0.0), (10.0, 10.0))
        self.field = MoteField(specs, names, network, field, one.wire, np.random.default_rng(5), TICK_S)

    def run(self, seconds):
        self.one.run(seconds, each=lambda: self.field.step(self.places))

    def readings(self):
        return [received.message for received in self._readings.drain()]

    def heard(self, robot="r1"):
        return self.one.call("snw_exploration", "motes", robot=robot)


@pytest.fixture
def air(stage):
    return lambda **options: Air(stage(), **options)


def test_a_visit_brings_in_everything_that_was_sensed_before(air):
    visit = air(motes=3)
    visit.run(400.0)
    assert visit.readings() == []
    visit.places = [Point2D(4.0, 2.0)]
    visit.run(30.0)
    readings = visit.readings()
    brought = {name: sorted(each.sequence for each in readings if each.mote == name) for name in ("m1", "m2", "m3")}
    for sequences in brought.values():
        assert sequences == list(range(len(sequences)))
        assert len(sequences) > 100
    assert [row["missing"] for row in visit.heard()] == [0, 0, 0]
    ages_s = [(each.stamp_ns - each.measured_ns) / 1e9 for each in readings]
    assert max(ages_s) == pytest.approx(400.0, abs=10.0)
