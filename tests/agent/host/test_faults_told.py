"""The team is told of a robot's faults: in its state, and in its log."""

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.table.topics import ROBOT_LOG, ROBOT_STATE

BROKEN = """
class Lidar(Device):
    period_s = 0.02
    broken = False
    def step(self):
        if self.broken: raise RuntimeError("it smokes")
class Camera(Device):
    def init(self): raise HardwareAbsent(self.env.plugin, "no camera at /dev/video0")
"""


def test_a_fault_and_its_end_are_told_to_the_team(bench):
    bench.code("eyes", BROKEN)
    bench.manifest("lidar", "eyes:Lidar", restart="on-failure", backoff_s=1.0)
    bench.manifest("camera", "eyes:Camera")
    states, log = Inbox(every=True), Inbox(every=True)
    bench.wire.subscribe(states, ROBOT_STATE)
    bench.wire.subscribe(log, ROBOT_LOG)
    bench.start("lidar", "camera")

    def told():
        bench.tick(7)
        faulted = [received.message for received in states.drain()][-1].faulted
        return {fault.plugin: fault.why for fault in faulted}, [
            (received.message.level, received.message.source, received.message.text) for received in log.drain()
        ]

    absent = {"camera": "hardware absent: no camera at /dev/video0"}
    assert told() == (absent, [("error", "camera", "does not run: hardware absent: no camera at /dev/video0")])
    assert told() == (absent, [])
    bench.plugin("lidar").broken = True
    where = f"{bench.place.name}/eyes.py:12 in step"
    smokes = f"RuntimeError: it smokes ({where})"
    faulted, ((level, source, text),) = told()
    assert faulted == {"camera": absent["camera"], "lidar": smokes}
    assert (level, source) == ("error", "lidar")
    first, _, traceback = text.partition("\n")
    assert first == f"does not run: {smokes}"
    assert traceback.endswith("RuntimeError: it smokes")
    bench.tick(50)
    assert told() == (absent, [("warning", "lidar", "runs again, or has gone")])


@pytest.mark.parametrize(("root", "why"), [("lidar", "RuntimeError: it smokes"), ("driver", "no plugin lidar")])
def test_a_cause_is_listed_once_with_all_that_do_not_run_because_of_it(bench, root, why):
    bench.code("eyes", f"{BROKEN}class Driver(Unit): ...\nclass Planner(Skill): ...\nclass Visit(Behavior): ...\n")
    if root == "lidar":
        bench.manifest("lidar", "eyes:Lidar")
    bench.manifest("driver", "eyes:Driver", requires=["lidar"])
    bench.manifest("planner", "eyes:Planner", requires=["driver"])
    bench.manifest("visit", "eyes:Visit", requires=["planner"])
    states, log = Inbox(every=True), Inbox(every=True)
    bench.wire.subscribe(states, ROBOT_STATE)
    bench.wire.subscribe(log, ROBOT_LOG)
    bench.start("visit")
    if root == "lidar":
        bench.plugin("lidar").broken = True
    bench.tick(10)
    (fault,) = [received.message for received in states.drain()][-1].faulted
    others = [name for name in ("driver", "planner", "visit") if name != root]
    assert (fault.plugin, fault.dependants) == (root, others)
    assert why in fault.words
    assert [received.message.source for received in log.drain()] == [root]
    infos = bench.infos()
    assert {name: infos[name].reason for name in others} == dict.fromkeys(others, f"because of {root}")
    assert infos[root].reason == infos[root].why != ""
