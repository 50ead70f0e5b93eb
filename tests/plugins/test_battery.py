import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.protocol.can.frames import codec
from robrain.protocol.wire.topics import ROBOT_STATE

WH_J = 3600.0


class BatteryManager:
    """The battery's node on the bus: tells a measurement as firmware would."""

    def __init__(self, stage):
        self.bus = stage.bus()
        self.sent = 0

    def frame(self, voltage_v, current_a, temperature_c=25.0):
        self.sent += 1
        return codec("BatteryStatus").pack(
            self.sent, voltage_v=voltage_v, current_a=current_a, temperature_c=temperature_c
        )

    def measure(self, voltage_v, current_a, temperature_c=25.0):
        self.bus.send(self.frame(voltage_v, current_a, temperature_c))


def discharge(stage, measurements, **battery):
    """State of a battery after these (volts, amperes), one every 0.2 s."""
    one = stage()
    host = one.host("battery", battery=battery)
    manager = BatteryManager(one)
    for voltage_v, current_a in measurements:
        manager.measure(voltage_v, current_a)
        one.run(0.2)
    state = one.call("battery", "state")
    one.hosts.remove(host)
    host.close()
    return state


def test_a_battery_that_was_never_measured_has_no_state(stage):
    one = stage()
    one.host("battery")
    states = one.inbox(ROBOT_STATE)
    one.run(1.0)
    assert one.call("battery", "state") is None
    assert states.drain()[-1].message.battery is None


def test_a_measurement_is_told_as_it_was_on_the_bus(stage):
    one = stage()
    one.host("battery")
    BatteryManager(one).measure(14.321, 1.234, -7.5)
    one.run(0.4)
    assert one.call("bm2", "latest") == {
        "stamp_ns": 0,
        "voltage_v": pytest.approx(14.321),
        "current_a": pytest.approx(1.234),
        "temperature_c": pytest.approx(-7.5),
    }


def test_a_minute_at_24_w_takes_1440_j_out_of_the_battery(stage):
    state = discharge(stage, [(12.0, 2.0)] * 301, capacity_wh=20.0)
    assert state["remaining_j"] == pytest.approx(20.0 * WH_J - 1440.0)
    assert state["soc"] == pytest.approx(1.0 - 1440.0 / (20.0 * WH_J))


def test_what_is_left_travels_in_the_robots_state(stage):
    one = stage()
    one.host("battery", battery={"capacity_wh": 10.0, "soc_at_start": 0.5})
    states = one.inbox(ROBOT_STATE)
    BatteryManager(one).measure(12.0, 1.0)
    one.run(0.5)
    battery = states.drain()[-1].message.battery
    assert (battery.soc, battery.remaining_j) == (0.5, 5.0 * WH_J)
    assert (battery.voltage_v, battery.current_a, battery.temperature_c) == (12.0, 1.0, 25.0)


def test_counting_does_not_depend_on_how_often_the_battery_is_measured(stage):
    often = discharge(stage, [(12.0, 2.0)] * 51)
    one = stage()
    one.host("battery")
    manager = BatteryManager(one)
    for _ in range(6):
        manager.measure(12.0, 2.0)
        one.run(2.0)
    assert one.call("battery", "state")["remaining_j"] == pytest.approx(often["remaining_j"])


def test_an_empty_battery_is_empty_and_no_less(stage):
    state = discharge(stage, [(12.0, 30.0)] * 20, capacity_wh=0.1)
    assert (state["remaining_j"], state["soc"]) == (0.0, 0.0)


def test_a_charged_battery_is_full_and_no_more(stage):
    state = discharge(stage, [(14.0, -5.0)] * 20, capacity_wh=1.0, soc_at_start=0.99)
    assert (state["remaining_j"], state["soc"]) == (WH_J, 1.0)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(10.0, 16.0), st.floats(-30.0, 30.0)), min_size=2, max_size=12))
def test_energy_is_counted_between_each_two_measurements(stage, measurements):
    told = [(round(volts, 3), round(amperes, 3)) for volts, amperes in measurements]
    state = discharge(stage, told, capacity_wh=100.0, soc_at_start=0.5)
    powers_w = [volts * amperes for volts, amperes in told]
    used_j = sum(0.2 * (before + after) / 2 for before, after in itertools.pairwise(powers_w))
    assert state["remaining_j"] == pytest.approx(50.0 * WH_J - used_j, abs=0.5)


def test_a_corrupt_measurement_is_not_believed(stage):
    one = stage()
    one.host("battery")
    manager = BatteryManager(one)
    manager.measure(12.0, 1.0)
    corrupt = manager.frame(3.0, 30.0)
    corrupt.data[0] ^= 1
    manager.bus.send(corrupt)
    one.run(0.4)
    assert one.call("battery", "state")["voltage_v"] == 12.0


def test_a_frame_of_another_identifier_space_is_no_measurement(stage):
    one = stage()
    one.host("battery")
    manager = BatteryManager(one)
    frame = manager.frame(3.0, 30.0)
    frame.is_extended_id = True
    manager.bus.send(frame)
    one.run(0.4)
    assert one.call("bm2", "latest") is None


def test_a_robot_whose_battery_bus_is_absent_tells_no_battery_and_why(stage):
    one = stage()
    one.host("battery", "scan", bm2={"interface": "socketcan", "channel": "nonexistent0"})
    one.run(0.2)
    infos = one.infos()
    assert infos["scan"].state == "active"
    assert infos["bm2"].why.startswith("hardware absent: no CAN bus at socketcan:nonexistent0")
    assert "nonexistent0" in infos["battery"].why


@pytest.mark.parametrize(
    ("battery", "expected"),
    [
        ({"capacity_wh": 0.0}, "expected capacity_wh > 0, got 0.0"),
        ({"soc_at_start": 1.5}, "expected soc_at_start from 0 to 1, got 1.5"),
        ({"capacity": 3.0}, "unknown field `capacity`"),
    ],
)
def test_a_battery_with_wrong_parameters_is_left_out_with_the_reason(stage, battery, expected):
    one = stage()
    one.host("battery", battery=battery)
    why = one.infos()["battery"].why
    assert "battery.toml: [parameters]" in why
    assert expected in why
