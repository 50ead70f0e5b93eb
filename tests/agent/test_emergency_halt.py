import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Explore
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import Halt, TaskOffer
from robrain.protocol.wire.topics import HALT, ROBOT_OFFER, ROBOT_STATE

ROBOT = """
    DIARY = []

    class Stopping:
        period_s = 0.02
        def emergency_halt(self): DIARY.append(f"halt {self.env.plugin}")
        def step(self): DIARY.append(f"step {self.env.plugin}")
        @external
        def ping(self) -> str: return "pong"

    class WheelsInterface(Protocol):
        def ping(self) -> str: ...

    class Wheels(Stopping, Device):
        interface = WheelsInterface

    class Drive(Stopping, Unit):
        def activate(self): self.wheels = self.env.use("wheels", WheelsInterface)
        def emergency_halt(self):
            super().emergency_halt()
            try:
                self.wheels.ping()
            except PluginInactive as error:
                DIARY.append(str(error))

    class Plan(Stopping, Skill): pass
    class Roam(Stopping, Behavior): pass

    class Stubborn(Stopping, Device):
        def emergency_halt(self):
            super().emergency_halt()
            raise OSError("the bus is gone")
"""


@pytest.fixture
def robot(bench):
    bench.code("robot", ROBOT)
    bench.manifest("a_roam", "robot:Roam", requires=["b_plan"])
    bench.manifest("b_plan", "robot:Plan", requires=["drive"])
    bench.manifest("drive", "robot:Drive", requires=["wheels"])
    bench.manifest("wheels", "robot:Wheels", visibility=["*", "command"])
    bench.manifest("arm", "robot:Stubborn")
    bench.code("unfinished", "import no_such_module")
    bench.manifest("unfinished", "unfinished:Unfinished")
    bench.start("a_roam", "arm", "unfinished")
    bench.halts = bench.operator.publisher(HALT)
    bench.tick()
    diary(bench).clear()
    return bench


def diary(bench):
    return bench.plugin("wheels").step.__func__.__globals__["DIARY"]


def halt(bench, *, halted):
    bench.halts.put(Halt(halted=halted, by="operator", reason="a test"))
    bench.tick()


def states(bench):
    return {name: info.state for name, info in bench.infos().items() if name != "unfinished"}


def test_devices_stop_first_then_upwards_even_if_one_fails_or_was_never_there(robot):
    halt(robot, halted=True)
    halted = [entry.removeprefix("halt ") for entry in diary(robot) if entry.startswith("halt")]
    assert set(halted[:2]) == {"wheels", "arm"}
    assert halted[2:] == ["drive", "b_plan", "a_roam"]
    assert set(states(robot).values()) == {"halted"}
    assert robot.infos()["unfinished"].state == "faulted"


def test_calls_are_refused_before_anything_is_halted(robot, monkeypatch):
    codes = []

    def call_the_behavior():
        with pytest.raises(CallError) as refused:
            robot.call("a_roam", "ping")
        codes.append(refused.value.code)

    monkeypatch.setattr(robot.plugin("wheels"), "emergency_halt", call_the_behavior)
    halt(robot, halted=True)
    assert codes == [ErrorCode.HALTED]
    assert "wheels is halted: emergency halt" in diary(robot)


def test_nothing_steps_while_the_robot_is_halted(robot):
    halt(robot, halted=True)
    diary(robot).clear()
    robot.tick(5)
    assert diary(robot) == []


def test_a_halt_stays_until_it_is_ended_in_so_many_words(robot):
    halt(robot, halted=True)
    robot.tick(500)
    assert set(states(robot).values()) == {"halted"}
    halt(robot, halted=False)
    assert set(states(robot).values()) == {"active"}
    assert robot.call("a_roam", "ping") == "pong"
    diary(robot).clear()
    robot.tick()
    assert diary(robot)


def test_a_second_halt_halts_once_more(robot):
    halt(robot, halted=True)
    halt(robot, halted=True)
    assert diary(robot).count("halt wheels") == 2
    halt(robot, halted=False)
    assert set(states(robot).values()) == {"active"}


def test_a_halt_and_its_end_in_one_turn_leave_the_robot_running_and_stopped_once(robot):
    robot.halts.put(Halt(halted=True, by="operator"))
    halt(robot, halted=False)
    assert diary(robot).count("halt wheels") == 1
    assert set(states(robot).values()) == {"active"}


def test_the_end_of_a_halt_does_not_wake_the_faulted(robot):
    robot.hosts[-1].manager.get("b_plan").fault(ValueError("broken"))
    halt(robot, halted=True)
    halt(robot, halted=False)
    assert states(robot)["b_plan"] == "faulted"


def test_a_halted_robot_says_so_and_takes_no_tasks(robot):
    inbox = Inbox()
    robot.operator.subscribe(inbox, ROBOT_STATE)
    halt(robot, halted=True)
    robot.tick(6)
    assert inbox.drain()[-1].message.halted
    offer = TaskOffer(task=Explore(id="t", goal=Point2D(0.0, 0.0)), epoch=1, lease_s=1.0)
    assert b"the robot is halted" in robot.operator.ask(ROBOT_OFFER, offer, robot="r1")
