import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.payloads import Quantity
from robrain.sim.motes.field import FieldSpec, Plume, SimulatedField

ORIGIN = Point2D(0.0, 0.0)


def still(*plumes):
    return SimulatedField(FieldSpec(), list(plumes), Point2D(-50.0, -50.0), (100.0, 100.0))


def test_a_plume_is_warm_in_the_middle_and_fades():
    field = still(Plume(0.0, 0.0, 0.0, 0.0))
    values = [field.value(Quantity.TEMPERATURE, Point2D(x_m, 0.0), 7.0) for x_m in (0.0, 1.0, 3.0, 9.0, 30.0)]
    assert values[0] == 29.0
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(20.0)


def test_a_plume_is_carried_along():
    field = still(Plume(-4.0, 0.0, 0.2, 0.0))
    warmest_s = max(range(60), key=lambda time_s: field.value(Quantity.TEMPERATURE, ORIGIN, float(time_s)))
    assert warmest_s == 20


def test_what_leaves_on_one_side_comes_back_on_the_other():
    field = still(Plume(0.0, 0.0, 1.0, 0.0))
    assert field.value(Quantity.LIGHT, ORIGIN, 100.0) == pytest.approx(field.value(Quantity.LIGHT, ORIGIN, 0.0))
    assert field.value(Quantity.LIGHT, ORIGIN, 50.0) == pytest.approx(200.0)
