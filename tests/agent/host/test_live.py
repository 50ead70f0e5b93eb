"""The live drive of one robot, in a thread of the test's own process."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from robrain.agent.host import live_drive
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import SPARE, run_agent
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

    GO, ENTERED = threading.Event(), []

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

    class Stepping(Device):
        period_s = 0.02
        steps = 0
        def step(self): self.steps += 1

    class Odd(Device):
        period_s = 0.02
        def step(self): self.period_s = PERIODS[self.env.plugin]
    PERIODS = {"odd0": "0.1", "odd1": 0.0, "odd2": float("nan")}

    class Slow(Device):
        period_s = 0.005
        def step(self): threading.Event().wait(0.02)

    class Stuck(Device):
        period_s = 0.02
        def step(self):
            ENTERED.append(self.env.plugin)
            GO.wait(600)

"""
MANY, HUNG = 12, 4


@pytest.fixture
def start(bench) -> Iterator[Callable[..., LiveRobot]]:
    """Start plugins by their names: each is that of its class, with or without a number."""
    robots = []
    bench.code("robot", ROBOT)

    def start(*load):
        for name in load:
            requires = ["counter"] if name == "listener" else []
            tag = {"visibility": ["*", "command"], "requires": requires, "hang_s": PATIENCE_S}
            bench.manifest(name, f"robot:{name.rstrip('0123456789').title()}", **tag)
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
    robot = start("counter", "listener")
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
    until(lambda: robot.space["ENTERED"])
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


def numbered(name, count):
    return [f"{name}{number}" for number in range(count)]


def plugin_threads():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("plugin-")]


def steps(robot, count):
    return [robot.plugin(name).steps for name in numbered("stepping", count)]


@pytest.mark.slow
def test_many_plugins_share_a_few_threads_also_on_a_busy_machine(start):
    robot = start("counter", *numbered("stepping", MANY))
    most, is_over = [], threading.Event()
    for _ in range(4):
        threading.Thread(target=lambda: [sum(range(1000)) for _ in iter(is_over.is_set, True)]).start()
    try:
        until(lambda: most.append(len(plugin_threads())) or min(steps(robot, MANY)) > 60)
    finally:
        is_over.set()
    assert max(most) <= MANY + 1 + SPARE + 1
    assert robot.tag("counter").mailbox.wake is not None
    until(lambda: len(plugin_threads()) <= SPARE + 1)


def test_each_plugin_that_hangs_takes_one_thread_and_the_others_go_on(start):
    robot = start("counter", *numbered("stepping", MANY), *numbered("stuck", HUNG))
    until(lambda: len(robot.space["ENTERED"]) == HUNG)
    before = steps(robot, MANY)
    until(lambda: all(now > then + 20 for now, then in zip(steps(robot, MANY), before, strict=True)))
    assert {f"plugin-stuck{number}" for number in range(HUNG)} <= set(plugin_threads())
    until(lambda: len(plugin_threads()) <= HUNG + SPARE + 1)
    robot.space["GO"].set()
    until(lambda: len(plugin_threads()) <= SPARE + 1)


@pytest.mark.slow
def test_a_plugin_whose_period_is_none_is_faulted_and_the_others_go_on(start):
    robot = start("counter", *numbered("stepping", 2), *numbered("odd", 3))
    odd = [robot.tag(f"odd{number}") for number in range(3)]
    until(lambda: [plugin.state for plugin in odd] == ["faulted"] * 3)
    assert "expected period_s above 0, or None, got 0.0" in odd[1].state_reason
    before = steps(robot, 2)
    until(lambda: all(now > then + 20 for now, then in zip(steps(robot, 2), before, strict=True)))


def test_a_robot_that_cannot_start_closes_what_it_opened(bench):
    before = set(threading.enumerate())
    session = open_session(mode="peer", listen=["tcp/127.0.0.1:0"])
    robot_file = RobotFile(robot=RobotTable("r1", places=[str(bench.place)], load=["ghost"]))
    host = AgentHost(robot_file, Path(), session, LiveClock(), Drive.LIVE)
    with pytest.raises(Exception, match="no plugin ghost"):
        run_agent(host, lambda: False, lambda: pytest.fail("it is not ready"))
    session.close()
    until(lambda: not threads_since(before, "plugin-"))
