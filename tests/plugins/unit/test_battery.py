from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robrain.agent.board import Board
from robrain.agent.event import Mailbox
from robrain.algorithms.energy.battery_report import NOTHING_MORE, BatteryReport
from robrain.algorithms.energy.battery_tracker import TrackedReading
from robrain.plugins.device.bm2.interface import BatteryMeasurement
from robrain.plugins.unit.battery import Battery
from robrain.protocol.can.frames import codec
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
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


LIES = {
    "out of range": lambda volts, amperes, celsius: (2.0, amperes, celsius),
    "jumped": lambda volts, amperes, celsius: (volts - 1.0, amperes, celsius),
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


class Believed:
    """A tracker with a given estimate that records its input."""

    def __init__(self) -> None:
        self.soc, self.soc_sd, self.health = 0.5, 0.0123456, 0.93456
        self.doubt_reason = ""
        self.given: list[tuple[str, tuple[Any, ...]]] = []
        self.filter = self

    def interval_j(self) -> tuple[float, float, float]:
        return 1000.04, 900.06, 1100.04

    def begin(self, *given: Any) -> None:
        self.given.append(("begin", given))

    def follow(self, *given: Any) -> None:
        self.given.append(("follow", given))

    def no_reading(self, *given: Any) -> None:
        self.given.append(("nothing", given))


class Robot:
    """A battery unit with a fake manager, and its alarms."""

    def __init__(self, **parameters: Any) -> None:
        self.clock = VirtualClock(to_ns(50.0))
        self.board = Board()
        self.measured: BatteryMeasurement | None = None
        bm2 = SimpleNamespace(latest=lambda: self.measured)
        env: Any = SimpleNamespace(clock=self.clock, board=self.board, use=lambda _name, _interface: bm2)
        self.it = Battery(env, Battery.Parameters(**parameters))
        self.it.init()
        self.it.activate()
        self.believed = Believed()
        self.it._tracker = self.believed
        self.alarms: list[tuple[str, str]] = []
        self._mailbox = Mailbox()
        for name in ("low", "cut_off", "implausible"):
            getattr(self.it, name).add(
                lambda alarm, name=name: self.alarms.append((name, alarm.why if hasattr(alarm, "why") else alarm[0])),
                self._mailbox,
            )

    def measure(self, voltage_v=15.0, current_a=1.0, charge_c=0.0, energy_j=0.0, at_s=0.0, from_s=0.0):
        """Deliver a measurement now."""
        self.measured = BatteryMeasurement(to_ns(at_s), voltage_v, current_a, 21.5, charge_c, energy_j, to_ns(from_s))
        return self.step()

    def step(self, after_s=0.2):
        self.clock.advance_to(self.clock.now_ns() + to_ns(after_s))
        self.it.step()
        self._mailbox.deliver()
        return self.board.battery

    def told(self):
        """Alarms since the last call, by name."""
        alarms, self.alarms = self.alarms, []
        return [name for name, _ in alarms]


@pytest.fixture
def robot():
    return Robot()


# -- measurements -----------------------------------------------------------------------------------------------


def test_before_the_first_measurement_nothing_is_told(robot):
    assert robot.step() is None
    assert (robot.it.drawn(), robot.it.state(), robot.believed.given) == (None, None, [])


def test_measurements_are_followed_from_the_first_on_with_what_has_flown_between(robot):
    robot.measure(at_s=1.0, charge_c=5.0, energy_j=70.0)
    robot.measure(14.0, 2.0, at_s=1.5, charge_c=6.5, energy_j=91.0)
    assert robot.believed.given == [
        ("begin", (TrackedReading(15.0, 1.0, 21.5), NOTHING_MORE)),
        ("follow", (TrackedReading(14.0, 2.0, 21.5), 1.5, 0.5, NOTHING_MORE)),
    ]
    assert robot.it.drawn() == (to_ns(1.5), 21.0, True)


@pytest.mark.parametrize("has_current", [True, False])
def test_what_a_battery_reports_goes_with_its_measurement_and_a_guessed_current_teaches_nothing(robot, has_current):
    report = BatteryReport(has_current=has_current, soc=0.4)
    for second in (1, 2):
        robot.measured = BatteryMeasurement(to_ns(second), 15.0, 1.0, 21.5, report=report)
        robot.step()
    assert [given[-1] for _, given in robot.believed.given] == [report, report]
    assert robot.it.drawn().trusted is has_current


def test_count_that_began_anew_is_made_up_from_the_measurement(robot):
    robot.measure(at_s=1.0, charge_c=500.0, energy_j=7000.0)
    robot.measure(14.0, 3.0, at_s=1.5, charge_c=0.0, energy_j=0.0, from_s=1.5)
    assert robot.believed.given[1] == ("follow", (TrackedReading(14.0, 3.0, 21.5), 1.5, 0.5, NOTHING_MORE))
    assert robot.it.drawn().energy_j == 21.0


def test_silence_is_told_since_the_last_measurement_and_since_the_last_step(robot):
    robot.measure(at_s=1.0)
    robot.step(0.5)
    robot.measured = None
    robot.step(0.25)
    assert robot.believed.given[1:] == [("nothing", (0.5, 0.5)), ("nothing", (0.75, 0.25))]
    robot.measure(at_s=2.0)
    robot.step(0.125)
    assert robot.believed.given[-1] == ("nothing", (0.125, 0.125))


@pytest.mark.parametrize(
    ("current_a", "charging", "is_own"), [(-0.051, True, False), (-0.05, False, False), (0.1, False, True)]
)
@pytest.mark.parametrize("why", ["", "it lies"])
def test_charge_is_one_only_if_it_is_believed_and_so_is_what_is_drawn(robot, current_a, charging, is_own, why):
    robot.believed.doubt_reason = why
    state = robot.measure(current_a=current_a)
    assert state.charging is (charging and not why)
    assert state.implausible == why
    assert robot.it.drawn().trusted is (is_own and not why)


# -- warnings ---------------------------------------------------------------------------------------------------


def at(robot, soc, voltage_v=15.0, why=""):
    robot.believed.soc, robot.believed.doubt_reason = soc, why
    robot.measure(voltage_v)
    return robot.told()


def test_low_is_told_at_its_threshold_once_and_again_after_a_charge_beyond_the_hysteresis(robot):
    assert at(robot, 0.251) == []
    assert at(robot, 0.25) == ["low"]
    assert at(robot, 0.2) == []
    assert at(robot, 0.3) == []
    assert at(robot, 0.25) == []
    assert at(robot, 0.301) == []
    assert at(robot, 0.25) == ["low"]


def test_cut_off_is_told_by_the_charge_or_by_a_voltage_that_is_believed(robot):
    assert at(robot, 0.051) == ["low"]
    assert at(robot, 0.05) == ["cut_off"]
    assert at(robot, 0.1) == []
    assert at(robot, 0.05) == []
    assert at(robot, 0.101) == []
    assert at(robot, 0.5, 12.0) == []
    assert at(robot, 0.5, 11.999) == ["cut_off"]
    assert at(robot, 0.5, 11.999) == []
    assert at(robot, 0.5) == []
    assert at(robot, 0.5, 11.0, "it lies") == ["implausible"]
    assert at(robot, 0.5, 11.0) == ["cut_off"]


def test_doubt_is_told_once_for_each_time(robot):
    assert at(robot, 0.5, why="it lies") == ["implausible"]
    assert at(robot, 0.5, why="it lies again") == []
    assert at(robot, 0.5) == []
    assert at(robot, 0.5, why="it lies") == ["implausible"]
