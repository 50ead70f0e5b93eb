"""The battery unit on given measurements: counting, reporting, warnings."""

from types import SimpleNamespace
from typing import Any

import pytest

from robrain.agent.board import Board
from robrain.agent.event import Mailbox
from robrain.algorithms.energy.battery_report import NOTHING_MORE, BatteryReport
from robrain.algorithms.energy.battery_tracker import TrackedReading
from robrain.plugins.device.bm2.interface import BatteryMeasurement
from robrain.plugins.unit.battery import Battery
from robrain.protocol.clock import VirtualClock, to_ns


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


def test_clock_that_goes_back_counts_nothing(robot):
    robot.measure(at_s=2.0)
    robot.measure(at_s=1.0, charge_c=9.0, energy_j=99.0)
    assert len(robot.believed.given) == 1
    robot.measure(at_s=1.5, charge_c=10.0, energy_j=100.0)
    assert robot.believed.given[1:] == [("follow", (TrackedReading(15.0, 1.0, 21.5), 1.0, 0.5, NOTHING_MORE))]
    assert robot.it.drawn().energy_j == 1.0


def test_silence_is_told_since_the_last_measurement_and_since_the_last_step(robot):
    robot.measure(at_s=1.0)
    robot.step(0.5)
    robot.measured = None
    robot.step(0.25)
    assert robot.believed.given[1:] == [("nothing", (0.5, 0.5)), ("nothing", (0.75, 0.25))]
    robot.measure(at_s=2.0)
    robot.step(0.125)
    assert robot.believed.given[-1] == ("nothing", (0.125, 0.125))


def test_state_is_told_in_no_more_digits_than_are_known(robot):
    state = robot.measure(14.321, 1.5)
    assert (state.voltage_v, state.current_a, state.temperature_c) == (14.321, 1.5, 21.5)
    assert (state.remaining_j, state.remaining_low_j, state.remaining_high_j) == (1000.0, 900.1, 1100.0)
    assert (state.soc, state.soc_sd, state.health) == (0.5, 0.01235, 0.9346)
    assert robot.it.state() is state
    robot.believed.soc = 0.4567891
    assert robot.measure(at_s=1.0).soc == 0.45679


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


def test_voltage_below_the_cut_off_is_told_once_while_it_lasts_whatever_the_charge(robot):
    assert at(robot, 0.9, 11.0) == ["cut_off"]
    assert at(robot, 0.9, 11.0) == []


def test_doubt_is_told_once_for_each_time(robot):
    assert at(robot, 0.5, why="it lies") == ["implausible"]
    assert at(robot, 0.5, why="it lies again") == []
    assert at(robot, 0.5) == []
    assert at(robot, 0.5, why="it lies") == ["implausible"]
