import numpy as np
import pytest

from robrain.protocol.can.frames import codec
from robrain.protocol.table.topics import ROBOT_EVENT, ROBOT_STATE
from robrain.sim.firmware.battery import BatterySpec, Gauge, GaugeSpec, SimulatedBattery

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


class Pack:
    """A simulated battery on a robot's bus, behind a gauge that can be made to lie."""

    def __init__(self, stage, **spec):
        self.stage = stage
        self.battery = SimulatedBattery(BatterySpec(**spec))
        self.gauge = Gauge(GaugeSpec(), np.random.default_rng(1))
        self.manager = BatteryManager(stage)

    def run(self, seconds, load_w=10.0, supply_w=0.0, lie=lambda *reading: reading, step_s=0.2):
        battery = self.battery
        for _ in range(round(seconds / step_s)):
            battery.step(load_w, supply_w, step_s)
            reading = lie(*self.gauge.read(battery.voltage_v, battery.current_a, battery.temperature_c))
            if reading is not None:
                self.manager.measure(*reading)
            self.stage.run(step_s)
        return self.state()

    def state(self):
        return self.stage.call("battery", "state")


@pytest.fixture
def pack(stage):
    """A robot with this battery; what its plugin is told besides comes as `told`."""

    def build(told=None, **spec):
        one = stage()
        one.host("battery", battery=told or {})
        return Pack(one, **spec)

    return build


# -- what is measured -------------------------------------------------------------------------------------------


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
        "charge_c": 0.0,
        "energy_j": 0.0,
        "counted_from_ns": 0,
    }


def test_a_minute_at_24_w_takes_1440_j_out_of_the_battery(stage):
    one = stage()
    one.host("battery")
    manager = BatteryManager(one)
    for _ in range(301):
        manager.measure(15.0, 1.6)
        one.run(0.2)
    assert one.call("bm2", "latest")["energy_j"] == pytest.approx(1440.0)
    assert one.call("bm2", "latest")["charge_c"] == pytest.approx(96.0)


def test_a_battery_manager_that_is_loaded_anew_does_not_disturb_the_count(pack):
    one = pack(soc_at_start=0.8)
    one.run(60.0)
    before = one.state()
    one.stage.hosts[0].manager.reload("bm2")
    after = one.run(20.0)
    assert after["implausible"] == ""
    assert after["soc"] == pytest.approx(before["soc"], abs=0.01)
    drawn = one.stage.plugin("battery").drawn()
    assert drawn.energy_j == pytest.approx(one.battery.delivered_j, rel=0.03)


# -- what is left -----------------------------------------------------------------------------------------------


def test_what_is_left_travels_in_the_robots_state(pack):
    one = pack()
    states = one.stage.inbox(ROBOT_STATE)
    one.run(5.0)
    battery = states.drain()[-1].message.battery
    assert battery.soc == pytest.approx(1.0, abs=0.05)
    assert 0.7 * 20.0 * WH_J < battery.remaining_low_j < battery.remaining_j < battery.remaining_high_j
    assert (battery.charging, battery.implausible) == (False, "")


# -- a battery that lies ----------------------------------------------------------------------------------------


class Drift:
    """Voltage and current leave the truth slowly, and against each other."""

    def __init__(self):
        self.steps = 0

    def __call__(self, volts, amperes, celsius):
        self.steps += 1
        return volts - min(0.8, 0.03 * self.steps), amperes - min(3.0, 0.1 * self.steps), celsius


LIES = {
    "out of range": lambda volts, amperes, celsius: (2.0, amperes, celsius),
    "31.00 A": lambda volts, amperes, celsius: (volts, 31.0, celsius),
    "jumped": lambda volts, amperes, celsius: (volts - 1.0, amperes, celsius),
    "frozen": lambda volts, amperes, celsius: (15.5, 0.7, celsius),
    "the computer runs": lambda volts, amperes, celsius: (volts, 0.0, celsius),
    "contradicts": Drift(),
    "no measurement": lambda volts, amperes, celsius: None,
}


@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_named_told_outside_and_makes_the_robot_less_sure(pack, name):
    one = pack(soc_at_start=0.8)
    told = one.stage.inbox(ROBOT_EVENT, plugin="battery", event="implausible")
    honest = one.run(20.0)
    lied = one.run(15.0, lie=LIES[name])
    alarms = [received.message.value for received in told.drain()]
    assert any(name in alarm["why"] for alarm in alarms)
    assert lied["implausible"]
    assert lied["remaining_low_j"] < honest["remaining_low_j"] - 0.05 * 20.0 * WH_J
    assert lied["soc_sd"] > honest["soc_sd"] + 0.04
    assert abs(lied["soc"] - one.battery.soc) < 0.05  # the lie itself was not followed
    worse = one.run(60.0, lie=LIES[name])
    assert worse["soc_sd"] > lied["soc_sd"]


def test_a_robot_whose_first_measurement_is_a_lie_knows_nothing_and_says_so(pack):
    one = pack()
    state = one.run(0.4, lie=LIES["out of range"])
    assert state["implausible"]
    assert (state["soc"], state["soc_sd"] > 0.25) == (pytest.approx(0.5, abs=0.01), True)
    assert state["remaining_low_j"] == 0.0
