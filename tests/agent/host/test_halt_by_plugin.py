"""Plugins that halt their robot, and keep it halted; and plugins without which it does not drive."""

import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_RESUME, HOST_UNLOAD, ResumeRequest, UnloadRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.team_messages import HALT, Halt

CODE = """
    WHY = []
    FAULT = []

    class Button(Device):
        period_s = 0.02
        def activate(self):
            self.env.guard_resume(self.why)
            if FAULT: raise OSError("the chip is gone")
        def step(self):
            if FAULT: raise OSError("the chip is gone")
            if WHY: self.env.halt_robot(WHY[-1])
        def why(self):
            if "broken" in WHY: raise RuntimeError("broken")
            return "the chip is gone" if FAULT else WHY[-1] if WHY else ""

    class Wheels(Device):
        period_s = 0.02
        def init(self): self.steps = 0
        def step(self): self.steps += 1

    class Brake(Device):
        def activate(self):
            if FAULT: raise ValueError("no brake")
"""


@pytest.fixture
def robot(bench):
    bench.code("parts", CODE)
    bench.manifest("button", "parts:Button", essential=True, restart="on-failure", backoff_s=0.1)
    bench.manifest("wheels", "parts:Wheels")
    bench.manifest("brake", "parts:Brake", essential=True)
    bench.halts = bench.wire.publisher(HALT)
    bench.told = Inbox()
    bench.wire.subscribe(bench.told, ROBOT_LOG)
    return bench


@pytest.fixture
def driving(robot):
    robot.start("button", "wheels")
    robot.tick(2)
    return robot


def shared(bench, name):
    """A list of the plugins' module."""
    return bench.plugin("wheels").step.__func__.__globals__[name]


def is_halted(bench):
    steps = bench.plugin("wheels").steps
    bench.tick(2)
    return bench.plugin("wheels").steps == steps


def resume(bench, by="operator"):
    return bench.wire.ask(HOST_RESUME, ResumeRequest(by=by), robot="r1")


def resume_team(bench):
    bench.halts.put(Halt(halted=False, by="operator"))
    bench.tick()


def test_a_robot_that_a_plugin_halts_stands_in_the_same_turn_and_tells_the_team(driving):
    states = Inbox()
    driving.wire.subscribe(states, ROBOT_STATE)
    shared(driving, "WHY").append("the button is pressed")
    driving.tick()
    assert is_halted(driving)
    state = states.drain()[-1].message
    assert (state.halted, state.halted_by) == (True, ["button"])
    assert "halted by button: the button is pressed" in [record.message.text for record in driving.told.drain()]


@pytest.mark.parametrize("by", ["ann", "operator", "operator:bob", "button"])
def test_nobody_resumes_it_while_the_plugin_has_a_reason(driving, by):
    shared(driving, "WHY").append("the button is pressed")
    driving.tick()
    with pytest.raises(CallError, match="r1 stays halted: the button is pressed") as refused:
        resume(driving, by)
    assert refused.value.code is ErrorCode.REFUSED
    resume_team(driving)
    assert is_halted(driving)


def test_it_stays_halted_when_the_reason_is_gone_until_an_operator_resumes_it(driving):
    shared(driving, "WHY").append("the button is pressed")
    driving.tick()
    shared(driving, "WHY").clear()
    driving.tick(50)
    assert is_halted(driving)
    with pytest.raises(CallError, match="ann may not end the halt of button"):
        resume(driving, "ann")
    assert not resume(driving).halted
    assert not is_halted(driving)


def test_a_team_that_is_resumed_leaves_a_robot_halted_whose_button_was_pressed_meanwhile(driving):
    driving.halts.put(Halt(halted=True, by="operator"))
    driving.tick()
    shared(driving, "WHY").append("the button is pressed")
    resume_team(driving)
    assert is_halted(driving)
    assert driving.hosts[-1].halting.mark(driving.hosts[-1]._published).halted_by == ["operator", "button"]
    shared(driving, "WHY").clear()
    resume_team(driving)
    assert not is_halted(driving)


def test_a_plugin_that_raises_when_it_is_asked_keeps_the_robot_halted(driving):
    shared(driving, "WHY").append("broken")
    driving.tick()
    with pytest.raises(CallError, match="button does not say whether the robot may drive: RuntimeError: broken"):
        resume(driving)


def test_a_plugin_that_is_unloaded_is_not_asked_any_more(driving):
    shared(driving, "WHY").append("the button is pressed")
    driving.tick()
    driving.wire.ask(HOST_UNLOAD, UnloadRequest(plugin="button", cascade=False), robot="r1")
    assert not resume(driving).halted


def test_an_essential_plugin_that_faults_halts_the_robot_and_runs_again_after_it(driving):
    shared(driving, "FAULT").append(True)
    driving.tick(10)
    assert is_halted(driving)
    with pytest.raises(CallError, match="the chip is gone"):
        resume(driving)
    shared(driving, "FAULT").clear()
    resume(driving)
    driving.tick(10)
    assert driving.infos()["button"].state == "active"
    assert not is_halted(driving)


def test_an_essential_plugin_that_is_never_started_again_keeps_the_robot_halted(robot):
    robot.manifest("button", "parts:Button", essential=True)
    robot.start("button", "wheels")
    shared(robot, "FAULT").append(True)
    robot.tick(10)
    shared(robot, "FAULT").clear()
    with pytest.raises(CallError, match="button does not run: OSError: the chip is gone"):
        resume(robot)
    assert is_halted(robot)


def test_a_robot_does_not_drive_without_an_essential_plugin_that_cannot_start(robot):
    robot.start("button", "wheels", "brake")
    shared(robot, "FAULT").append(True)
    robot.wire.ask(HOST_UNLOAD, UnloadRequest(plugin="button", cascade=False), robot="r1")
    robot.hosts[-1].manager.get("brake").fault(ValueError("no brake"))
    robot.tick(20)
    assert is_halted(robot)
    with pytest.raises(CallError, match=r"r1 stays halted: brake does not run: ValueError: no brake"):
        resume(robot)
    robot.wire.ask(HOST_UNLOAD, UnloadRequest(plugin="brake", cascade=False), robot="r1")
    resume(robot)
    assert not is_halted(robot)


def test_a_robot_whose_essential_plugin_cannot_be_loaded_is_halted_from_the_start(robot):
    robot.code("lacking", "import no_such_module_of_anybody")
    robot.manifest("lacking", "lacking:Lacking", essential=True)
    robot.start("lacking", "wheels")
    robot.tick(1)
    assert is_halted(robot)
    with pytest.raises(CallError, match=r"lacking does not run: .*no_such_module_of_anybody"):
        resume(robot)
