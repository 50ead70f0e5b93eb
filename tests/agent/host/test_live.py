"""The live drive of one robot, in a thread of the test's own process."""

import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from robrain.agent.host import live_drive
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.lifecycle.managed_plugin import WAITS_S
from robrain.agent.lifecycle.transitions import Effect
from robrain.protocol.clock import LiveClock
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import open_session
from tests.agent.live_robot import LiveRobot
from tests.waiting import PATIENCE_S, until

ROBOT = """
    import threading

    GO = threading.Event()

    class CounterInterface(Protocol):
        ticked: Event[int]

    class Counter(Device):
        interface = CounterInterface
        period_s = 0.02
        ticked = Event[int]()
        steps = 0
        halts = 0
        def step(self):
            self.steps += 1
            self.thread = threading.current_thread().name
            self.ticked.notify(self.steps)
        def emergency_halt(self): self.halts += 1
        @external
        def press(self) -> int: return self.steps

    class Listener(Unit):
        heard = 0
        def activate(self): self.env.observe(self.env.use("counter", CounterInterface).ticked, self.hear)
        def hear(self, value):
            self.heard = value
            self.thread = threading.current_thread().name

    class Slow(Device):
        period_s = 0.005
        def step(self): threading.Event().wait(0.02)

    class Stuck(Device):
        period_s = 0.02
        stuck = False
        def step(self):
            self.stuck = True
            GO.wait()

"""
CLASSES = {"counter": "Counter", "listener": "Listener", "slow": "Slow", "stuck": "Stuck"}


@pytest.fixture
def start(bench) -> Iterator[type[LiveRobot]]:
    robots = []
    bench.code("robot", ROBOT)
    for name, class_name in CLASSES.items():
        requires = ["counter"] if name == "listener" else []
        tag = {"visibility": ["*", "command"], "requires": requires, "hang_s": PATIENCE_S}
        bench.manifest(name, f"robot:{class_name}", **tag)

    def start(*load):
        robots.append(LiveRobot(bench.place, load, space_of="counter", threads="plugin-"))
        assert robots[-1].ready.wait(PATIENCE_S)
        return robots[-1]

    yield start
    for robot in robots:
        robot.close()


def test_steps_happen_on_a_thread_that_has_the_plugins_name_meanwhile(start):
    robot = start("counter")
    until(lambda: robot.plugin("counter").steps >= 5)
    assert robot.plugin("counter").thread == "plugin-counter"
    assert msgspec.json.decode(robot.call("counter", "press")) >= 5


def test_events_wake_the_observer_and_are_not_delivered_on_the_notifiers_thread(start):
    robot = start("listener")
    until(lambda: robot.plugin("listener").heard >= 3)
    assert robot.plugin("listener").thread == "plugin-listener"


@pytest.mark.slow
def test_closing_leaves_no_thread_behind(start):
    before = set(threading.enumerate())
    robot = start("counter", "listener", "slow")
    robot.call("counter", "press")
    until(lambda: robot.infos()["slow"].overruns >= 3)
    assert threads_since(before, "plugin-")
    assert threads_since(before, "halt-r1-")
    robot.stop()
    until(lambda: not threads_since(before, "plugin-", "halt-", "robrain-"))  # none is waited for without a limit


def threads_since(before, *names):
    """Threads that were not there before and whose names begin so."""
    return [thread.name for thread in set(threading.enumerate()) - before if thread.name.startswith(names)]


@pytest.fixture
def stuck_robot(start, monkeypatch):
    monkeypatch.setattr(live_drive, "JOIN_TIMEOUT_S", 0.5)
    monkeypatch.setitem(WAITS_S, Effect.ASK, 0.5)
    robot = start("stuck", "counter")
    stuck = robot.plugin("stuck")
    until(lambda: stuck.stuck)
    yield robot
    robot.space["GO"].set()
    robot.stop()
    until(lambda: not any(thread.name == "plugin-stuck" for thread in threading.enumerate()))


def test_a_plugin_that_hangs_does_not_delay_an_emergency_halt(stuck_robot):
    counter = stuck_robot.plugin("counter")
    stuck_robot.wire.publisher(HALT).put(Halt(halted=True, by="operator"))
    until(lambda: stuck_robot.infos()["counter"].state == "halted")
    until(lambda: counter.halts >= 1)
    assert stuck_robot.infos()["stuck"].state == "halted"


@pytest.mark.slow
def test_a_plugin_that_hangs_is_left_behind_at_the_end(stuck_robot):
    stuck_robot.stop()
    states = {name: tag.state.value for name, tag in stuck_robot.host.manager.plugins.items()}
    assert states == {"stuck": "faulted", "counter": "inactive"}


def test_a_robot_that_cannot_start_closes_what_it_opened(bench):
    before = set(threading.enumerate())
    session = open_session(mode="peer", listen=["tcp/127.0.0.1:0"])
    robot_file = RobotFile(robot=RobotTable("r1", places=[str(bench.place)], load=["ghost"]))
    host = AgentHost(robot_file, Path(), session, LiveClock(), Drive.LIVE)
    with pytest.raises(Exception, match="no plugin ghost"):
        run_agent(host, lambda: False, lambda: pytest.fail("it is not ready"))
    session.close()
    until(lambda: not threads_since(before, "plugin-"))
