"""The team is told of a robot's faults: in its state, and in its log."""

from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ROBOT_LOG, ROBOT_STATE

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
