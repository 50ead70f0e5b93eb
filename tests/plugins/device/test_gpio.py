"""Bumpers and the emergency stop on the lines of a simulated GPIO chip, through gpiod's own types."""

import math
from collections.abc import Iterator
from typing import Any

import gpiod
import pytest

from robrain.agent.authoring.testing import PluginBench
from robrain.plugins.device import gpio
from robrain.plugins.device.gpio import BumperContact, GpioAbsent, GpioBumpers, GpioEmergencyStop
from robrain.plugins.device.range_sensors import Bump
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_RESUME, ResumeRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from tests.plugins.device.bare_device import BareDevice
from tests.plugins.device.gpio_chip import GpioChip

FRONT, LEFT = 17, 22
CONTACTS = (BumperContact(line=FRONT, direction_rad=0.0), BumperContact(line="LEFT", direction_rad=math.pi / 2))


@pytest.fixture
def chip(monkeypatch: pytest.MonkeyPatch) -> Iterator[GpioChip]:
    one = GpioChip({"LEFT": LEFT, "STOP": 27})
    monkeypatch.setattr(gpio.gpiod, "request_lines", one.request_lines)
    yield one
    assert not one.consumers, "all lines are given back"


# -- bumpers ----------------------------------------------------------------------------------------------------


@pytest.fixture
def bumpers(chip: GpioChip) -> Iterator[BareDevice]:
    one = BareDevice(GpioBumpers, contacts=CONTACTS)
    one.it.activate()
    yield one
    one.it.deactivate()


def test_each_change_of_the_contacts_is_told_once(bumpers: BareDevice, chip: GpioChip) -> None:
    told = bumpers.told(bumpers.it.bumped)
    for pressed in ([], [FRONT], [FRONT], [FRONT, LEFT], [LEFT], []):
        chip.levels = dict.fromkeys(pressed, False)  # to ground
        bumpers.step(0.02)
    assert [bump.directions_rad for bump in told] == [(0.0,), (0.0, math.pi / 2), (math.pi / 2,), ()]
    assert told[-1] == Bump(bumpers.clock.now_ns() - 0, ())
    assert bumpers.it.pressed_rad() == ()
    assert bumpers.it.latest() is None


def test_contacts_to_the_supply_are_pressed_when_they_are_high(chip: GpioChip) -> None:
    one = BareDevice(GpioBumpers, contacts=CONTACTS, is_pressed_low=False, pull="down")
    one.it.activate()
    one.step()
    assert one.it.pressed_rad() == ()
    chip.levels[LEFT] = True
    one.step()
    assert one.it.pressed_rad() == (math.pi / 2,)
    one.it.deactivate()


def test_a_chip_that_is_pulled_out_is_a_fault_that_names_its_lines(bumpers: BareDevice, chip: GpioChip) -> None:
    bumpers.step()
    chip.is_there = False
    with pytest.raises(GpioAbsent, match=r"cannot read lines 17, LEFT of /dev/gpiochip0: .*No such device"):
        bumpers.step()


@pytest.mark.parametrize(
    ("lines", "why"),
    [((40,), "Invalid argument"), (("NONE",), "no line named 'NONE'"), ((3, 5), "Device or resource busy")],
)
def test_lines_that_cannot_be_had_are_a_fault(chip: GpioChip, lines: Any, why: str) -> None:
    chip.consumers[5] = "somebody"
    one = BareDevice(GpioBumpers, contacts=tuple(BumperContact(line=line, direction_rad=0.0) for line in lines))
    with pytest.raises(GpioAbsent, match=why):
        one.it.activate()
    assert chip.consumers.pop(5) == "somebody"


# -- the emergency stop -----------------------------------------------------------------------------------------


class Robot:
    """A robot with a button between line 27 and ground, and a plugin that would drive."""

    def __init__(self, bench: PluginBench) -> None:
        self.bench = bench
        self.states = Inbox()
        bench.wire.subscribe(self.states, ROBOT_STATE)
        self.changes = Inbox()
        bench.wire.subscribe(self.changes, ROBOT_EVENT, plugin="emergency_stop", event="changed")

    def is_halted(self) -> bool:
        self.bench.run(0.12)
        return bool(self.states.drain()[-1].message.halted)

    def resume(self) -> None:
        self.bench.wire.ask(HOST_RESUME, ResumeRequest(by="operator"), robot="r1")


@pytest.fixture
def robot(chip: GpioChip, request: pytest.FixtureRequest) -> Iterator[Robot]:
    chip.levels[27] = getattr(request, "param", False)
    roles = {"emergency_stop": "gpio_emergency_stop"}
    parameters = {"emergency_stop": {"lines": ["STOP"]}}
    with PluginBench(load=["emergency_stop"], roles=roles, parameters=parameters) as bench:
        yield Robot(bench)


def test_a_pressed_button_halts_the_robot_within_two_hundredths_of_a_second(robot: Robot, chip: GpioChip) -> None:
    assert not robot.is_halted()
    del chip.levels[27]  # pressed, or the cable is broken: the line is open
    robot.bench.run(0.02)
    assert robot.bench.host.manager.halted
    assert robot.is_halted()
    assert robot.bench.host.halting.mark(robot.bench.host._published).halted_by == ["emergency_stop"]
    (told,) = robot.changes.drain()
    assert "the emergency stop is pressed" in told.message.value["why"]


def test_the_robot_drives_again_when_the_button_is_released_and_an_operator_has_resumed_it(
    robot: Robot, chip: GpioChip
) -> None:
    del chip.levels[27]
    assert robot.is_halted()
    why = "r1 stays halted: the emergency stop is pressed, or its cable is broken: line STOP of /dev/gpiochip0"
    with pytest.raises(CallError, match=why):
        robot.resume()
    chip.levels[27] = False
    assert robot.is_halted()
    robot.resume()
    assert not robot.is_halted()
    del chip.levels[27]
    assert robot.is_halted()


def test_a_button_that_is_pressed_again_before_the_device_looks_halts_the_robot_again(
    robot: Robot, chip: GpioChip
) -> None:
    del chip.levels[27]
    assert robot.is_halted()
    chip.levels[27] = False
    robot.resume()
    del chip.levels[27]
    assert robot.is_halted()


@pytest.mark.parametrize("robot", [True], indirect=True)
def test_a_robot_that_is_started_with_its_button_pressed_does_not_drive(robot: Robot, chip: GpioChip) -> None:
    assert robot.is_halted()
    chip.levels[27] = False
    robot.resume()
    assert not robot.is_halted()


def test_a_chip_that_is_pulled_out_halts_the_robot_until_it_is_back(robot: Robot, chip: GpioChip) -> None:
    robot.bench.run(0.5)
    chip.is_there = False
    assert robot.is_halted()
    assert "GpioAbsent" in robot.bench.info("emergency_stop").why
    robot.bench.run(60.0)
    with pytest.raises(CallError, match="r1 stays halted: the emergency stop does not answer: cannot open line STOP"):
        robot.resume()
    chip.is_there = True
    robot.resume()
    robot.bench.run(1.0)
    assert robot.bench.info("emergency_stop").state == "active"
    assert not robot.is_halted()
    del chip.levels[27]
    assert robot.is_halted()


def test_a_robot_without_the_chip_of_its_button_does_not_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    one = GpioChip()
    one.is_there = False
    monkeypatch.setattr(gpio.gpiod, "request_lines", one.request_lines)
    with PluginBench(load=["emergency_stop"], roles={"emergency_stop": "gpio_emergency_stop"}) as bench:
        robot = Robot(bench)
        assert robot.is_halted()
        with pytest.raises(CallError, match="does not answer: cannot open line 27 of /dev/gpiochip0"):
            robot.resume()


class Button(BareDevice):
    """The device alone, and what it asks its host for; nothing else halts the robot when it faults."""

    def __init__(self) -> None:
        self.halts: list[str] = []
        self.guards: list[Any] = []
        super().__init__(GpioEmergencyStop, lines=(27,))

    def halt_robot(self, why: str) -> None:
        self.halts.append(why)

    def guard_resume(self, why_not: Any) -> None:
        self.guards.append(why_not)


def test_the_device_itself_halts_the_robot_before_it_faults(chip: GpioChip) -> None:
    one = Button()
    chip.levels[27] = False
    one.it.activate()
    told = one.told(one.it.changed)
    one.step()
    assert (one.halts, told) == ([], [])
    chip.is_there = False
    with pytest.raises(GpioAbsent):
        one.step()
    assert [change.why for change in told] == one.halts
    assert "cannot read line 27" in one.halts[0]
    one.it.deactivate()
    with pytest.raises(GpioAbsent):
        one.it.activate()
    assert "cannot open line 27" in one.halts[1]
    assert "does not answer" in one.guards[-1]()


def test_a_press_and_its_release_are_told_and_only_the_press_halts_the_robot(chip: GpioChip) -> None:
    one, why = Button(), "the emergency stop is pressed, or its cable is broken: line 27 of /dev/gpiochip0"
    chip.levels[27] = False
    one.it.activate()
    told = one.told(one.it.changed)
    for levels in ({}, {27: False}, {27: False}):
        chip.levels = levels
        one.step(0.01)
    assert [change.why for change in told] == [why, ""]
    assert one.halts == [why]
    one.it.deactivate()


@pytest.mark.parametrize("wired_to", ["ground", "supply"])
@pytest.mark.parametrize("lines", [(3,), (3, 4)])
@pytest.mark.parametrize("opened", [None, 3, 4])
def test_any_open_contact_is_a_pressed_button(chip: GpioChip, wired_to: str, lines: Any, opened: int | None) -> None:
    chip.levels = {line: wired_to == "supply" for line in (3, 4) if line != opened}
    one = BareDevice(GpioEmergencyStop, lines=lines, wired_to=wired_to)
    assert bool(one.it.pressed_reason()) == (opened in lines)


def test_resistors_of_the_board_are_left_to_do_their_work(chip: GpioChip, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def request(path: str, config: Any, consumer: str) -> Any:
        asked.extend(config.values())
        return chip.request_lines(path, config, consumer)

    monkeypatch.setattr(gpio.gpiod, "request_lines", request)
    BareDevice(GpioEmergencyStop, lines=(3,), own_pull=False).it.pressed_reason()
    assert [each.bias for each in asked] == [gpiod.line.Bias.DISABLED]
    assert asked[0].debounce_period.total_seconds() == 0.005
