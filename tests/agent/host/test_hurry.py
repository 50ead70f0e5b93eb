"""What must not wait for a period does not: hurried steps, and the robot's word that its task has changed."""

import threading

import pytest

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import PluginThreads
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.answers.trace import trace_of
from robrain.protocol.clock import LiveClock, VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import TaskOffer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.table.topics import ROBOT_CALL, ROBOT_OFFER, ROBOT_STATE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from tests.waiting import PATIENCE_S, until

PLUGIN = """
from robrain.agent.plugin import Behavior, external
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer

class Slow(Behavior):
    kind = "visit"
    period_s = 1.0

    def init(self):
        self.steps_ns = []

    def activate(self):
        self.env.do_tasks(lambda task: TaskAnswer(accepted=True), lambda why: None)

    def step(self):
        self.steps_ns.append(self.env.clock.now_ns())

    @external
    def hasten(self) -> None:
        self.env.hurry()

    @external
    def end(self) -> None:
        self.env.tasks.end("t1", TaskState.DONE)
"""
MANIFEST = '[plugin]\nclass = "slow:Slow"\n[tag]\nvisibility = ["command"]\n'


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "slow.py").write_text(PLUGIN, encoding="utf-8")
    (tmp_path / "slow.toml").write_text(MANIFEST, encoding="utf-8")
    return RobotFile(robot=RobotTable("r1", places=["."], load=["slow"])), tmp_path


class Lockstep:
    """One robot, tick by tick."""

    def __init__(self, session, robot_file, place):
        self.clock = VirtualClock()
        self.host = AgentHost(robot_file, place, session, self.clock, Drive.LOCKSTEP)
        self.wire = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.states = Inbox(every=True)
        self.wire.subscribe(self.states, ROBOT_STATE)
        self.host.start()

    def tick(self, count=1):
        for _ in range(count):
            self.clock.advance_to(self.clock.now_ns() + to_ns(0.02))
            self.host.step()

    @property
    def steps_s(self):
        return [stamp_ns / 1e9 for stamp_ns in self.host.manager.get("slow").plugin.steps_ns]

    def call(self, function):
        self.wire.ask(ROBOT_CALL, [], robot="r1", plugin="slow", function=function)

    def said(self):
        return [(received.message.stamp_ns / 1e9, received.message.task) for received in self.states.drain()]


@pytest.fixture
def lockstep(robot):
    with open_lockstep_session() as session:
        one = Lockstep(session, *robot)
        yield one
        one.host.close()
        one.wire.close()


def test_hurried_step_comes_with_the_next_tick_and_the_period_counts_anew(lockstep):
    lockstep.tick(20)
    lockstep.call("hasten")
    lockstep.tick(102)
    assert lockstep.steps_s == pytest.approx([0.02, 0.42, 1.42, 2.42])


def test_hurry_said_twice_is_one_step(lockstep):
    lockstep.tick(20)
    lockstep.call("hasten")
    lockstep.call("hasten")
    lockstep.tick(10)
    assert lockstep.steps_s == pytest.approx([0.02, 0.42])


def test_robot_says_at_once_that_its_task_has_begun_and_ended(lockstep):
    lockstep.tick(6)
    offer = TaskOffer(task=Task(id="t1", kind="visit", place=Point2D(1.0, 1.0)), epoch=1, lease_s=60.0)
    answer = lockstep.wire.ask(ROBOT_OFFER, offer, robot="r1")
    assert answer.accepted
    lockstep.said()
    lockstep.tick()
    ((stamp_s, task),) = lockstep.said()
    assert (stamp_s, task.state) == (pytest.approx(0.14), TaskState.RUNNING)
    lockstep.call("end")
    lockstep.tick()
    ((stamp_s, task),) = lockstep.said()
    assert (stamp_s, task.state) == (pytest.approx(0.16), TaskState.DONE)
    lockstep.tick(5)
    assert len(lockstep.said()) == 1  # and then ten times a second, as ever


def test_other_plugins_are_another_number_in_the_state(lockstep):
    lockstep.tick(6)
    first = lockstep.states.drain()[-1].message.loaded
    lockstep.host.manager.unload("slow")
    lockstep.tick(6)
    assert first != lockstep.states.drain()[-1].message.loaded != 0


def test_hurried_step_of_a_live_plugin_does_not_wait_for_its_period(robot):
    source = robot[1] / "slow.py"
    source.write_text(PLUGIN.replace("period_s = 1.0", f"period_s = {100 * PATIENCE_S}"), encoding="utf-8")
    with open_lockstep_session() as session:
        host = AgentHost(*robot, session, LiveClock(), Drive.LIVE)
        threads = PluginThreads(host)
        try:
            host.start()
            threads.follow()
            plugin = host.manager.get("slow").plugin
            until(lambda: plugin.steps_ns)
            plugin.hasten()
            until(lambda: len(plugin.steps_ns) > 1)
        finally:
            threads.stop()
            host.close()


def test_end_of_a_task_wakes_the_hosts_loop(robot):
    with open_lockstep_session() as session:
        host = AgentHost(*robot, session, LiveClock(), Drive.LIVE)
        try:
            woken = threading.Event()
            host.on_wanted(woken.set)
            host.start()
            host.desk.offer(
                TaskOffer(task=Task(id="t1", kind="visit", place=Point2D(1.0, 1.0)), epoch=1, lease_s=60.0), 0
            )
            assert not woken.is_set()
            task = Task(id="t2", kind="visit", place=Point2D(1.0, 1.0))
            host.desk.offer(TaskOffer(task=task, epoch=2, lease_s=60.0, after="t1"), 0)
            assert host.task_and_trace() == ("t1", trace_of("default", "t1"))  # not that of the one which is next
            host.manager.get("slow").plugin.end()
            assert woken.is_set()
            assert host.task_and_trace() == ("t2", trace_of("default", "t2"))
        finally:
            host.close()
