"""Host extensions: what each part of the host asks them, and that one which fails does not stop the robot."""

import msgspec
import pytest

from robrain.agent.host import agent_host
from robrain.agent.host.host_extension import HostExtension
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW, TaskOffer, TaskWithdrawal
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import Occupied
from robrain.protocol.registry import Registry

BUSY = Occupied("beacon", "it blinks")


class Beacon(HostExtension):
    """Refuses tasks, reports a behavior and fails in its steps."""

    def __init__(self, host):
        self.host, self.steps, self.starts = host, [], 0

    def start(self):
        self.starts += 1

    def offer_refusal(self, task_id, now_ns):
        return BUSY if task_id == "t1" else None

    def withdrawal_refusal(self, now_ns):
        return BUSY

    def step(self, now_ns, *, may_begin):
        self.steps.append(may_begin)
        raise RuntimeError("lamp is broken")

    def extend_state(self, state):
        return msgspec.structs.replace(state, lost="in fog")


@pytest.fixture
def beacon(bench, monkeypatch):
    stock = {"beacon": f"{__name__}:Beacon", "missing": "robrain.agent.nowhere:Nothing"}
    registry = Registry("host extension", "robrain.host_extensions", stock)
    registry._loaded["beacon"] = Beacon
    monkeypatch.setattr(agent_host, "HOST_EXTENSIONS", registry)
    bench.add(RobotFile(robot=RobotTable("r1", load=[]))).start()
    return bench.hosts[-1].extensions["beacon"]


@pytest.mark.sets_aside
def test_extension_answers_for_tasks_and_adds_to_the_state(bench, beacon):
    states = Inbox(every=True)
    bench.wire.subscribe(states, ROBOT_STATE)
    answers = []
    for task_id in ("t1", "t2"):
        task = Task(id=task_id, kind="visit", place=Point2D(1.0, 1.0))
        offer = TaskOffer(task=task, epoch=1, lease_s=2.0)
        answers.append(bench.wire.ask(ROBOT_OFFER, offer, robot="r1").reason)
    answers.append(bench.wire.ask(ROBOT_WITHDRAW, TaskWithdrawal(id="t1", epoch=1, why=""), robot="r1").reason)
    bench.tick(5)
    assert answers[0] == answers[2] == BUSY
    assert answers[1] != BUSY
    assert beacon.starts == 1
    assert [received.message.lost for received in states.drain()][-1] == "in fog"


@pytest.mark.sets_aside
def test_failing_extension_is_counted_and_one_that_cannot_be_imported_is_skipped(bench, beacon, caplog):
    bench.tick(3)
    host = bench.hosts[-1]
    host.halting.halt("operator", "")
    bench.tick(1)
    assert beacon.steps[-4:] == [True, True, True, False]
    (failure,) = host.refusals.counts()
    assert (failure.topic, failure.key, failure.count) == ("stage", "beacon", len(beacon.steps))
    assert list(host.extensions) == ["beacon"]
    texts = [record.getMessage() for record in caplog.get_records("setup")]
    assert any("missing" in text and "cannot be imported" in text for text in texts)
