"""What must not wait for a period does not: hurried steps, and the robot's report that its task has changed."""

import threading

import pytest

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import PluginThreads
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, TaskOffer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import open_lockstep_session
from tests.waiting import PATIENCE_S, until

SLOW = """
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer

class Slow(Behavior):
    kind = "visit"
    period_s = 1.0
    def init(self): self.steps_ns = []
    def activate(self): self.env.do_tasks(lambda task: TaskAnswer(accepted=True), lambda why: None)
    def step(self): self.steps_ns.append(self.env.clock.now_ns())
    @external
    def hasten(self) -> None: self.env.hurry()
    @external
    def end(self) -> None: self.env.tasks.end("t1", TaskState.DONE)
"""


def offer(task_id="t1", epoch=1, after=""):
    task = Task(id=task_id, kind="visit", place=Point2D(1.0, 1.0))
    return TaskOffer(task=task, epoch=epoch, lease_s=60.0, after=after)


@pytest.fixture
def robot(bench):
    bench.code("slow", SLOW)
    bench.manifest("slow", "slow:Slow")
    bench.states = Inbox(every=True)
    bench.wire.subscribe(bench.states, ROBOT_STATE)
    return bench


def test_hurried_step_comes_once_with_the_next_tick_and_the_period_counts_from_it(robot):
    robot.start("slow")
    robot.tick(20)
    for _ in range(2):
        robot.call("slow", "hasten")
    robot.tick(102)
    assert [stamp_ns / 1e9 for stamp_ns in robot.plugin("slow").steps_ns] == pytest.approx([0.02, 0.42, 1.42, 2.42])


def test_robot_says_at_once_that_its_task_has_begun_and_ended(robot):
    def reported():
        return [(received.message.stamp_ns / 1e9, received.message.task) for received in robot.states.drain()]

    robot.start("slow")
    robot.tick(6)
    assert robot.wire.ask(ROBOT_OFFER, offer(), robot="r1").accepted
    reported()
    robot.tick()
    ((stamp_s, task),) = reported()
    assert (stamp_s, task.state) == (pytest.approx(0.14), TaskState.RUNNING)
    robot.call("slow", "end")
    robot.tick()
    ((stamp_s, task),) = reported()
    assert (stamp_s, task.state) == (pytest.approx(0.16), TaskState.DONE)
    robot.tick(5)
    assert len(reported()) == 1  # and then ten times a second, as ever


def test_other_plugins_are_another_number_in_the_state(robot):
    host = robot.start("slow")
    robot.tick(6)
    first = robot.states.drain()[-1].message.loaded
    host.manager.unload("slow")
    robot.tick(6)
    assert first != robot.states.drain()[-1].message.loaded != 0


@pytest.fixture
def live(robot):
    """The robot's host in live, not yet started; its plugin has a period that never passes."""
    path = robot.place / "slow.py"
    path.write_text(path.read_text().replace("period_s = 1.0", f"period_s = {100 * PATIENCE_S}"))
    table = RobotTable("r1", places=[str(robot.place)], load=["slow"])
    with open_lockstep_session() as session:
        host = AgentHost(RobotFile(robot=table), robot.place, session, LiveClock(), Drive.LIVE)
        yield host
        host.close()


def test_hurried_step_of_a_live_plugin_does_not_wait_for_its_period(live):
    threads = PluginThreads(live)
    try:
        live.start()
        threads.follow()
        plugin = live.manager.get("slow").plugin
        until(lambda: plugin.steps_ns)
        plugin.hasten()
        until(lambda: len(plugin.steps_ns) > 1)
    finally:
        threads.stop()


def test_end_of_a_task_wakes_the_hosts_loop(live):
    woken = threading.Event()
    live.on_wanted(woken.set)
    live.start()
    live.desk.offer(offer(), 0)
    assert not woken.is_set()
    live.desk.offer(offer("t2", 2, after="t1"), 0)
    assert live.task_id() == "t1"  # not that of the next one
    live.manager.get("slow").plugin.end()
    assert woken.is_set()
    assert live.task_id() == "t2"
