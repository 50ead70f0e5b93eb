"""A line whose frames are late: what the robot's computer gets, when, and with which stamps."""

import can
import numpy as np
import pytest

from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.bus_line import BusLine, FrameStamps, LineFault
from robrain.sim.firmware.disturbance import DelayLine, DelaySpec

LATE_S = 0.1


class Line:
    """A line whose frames take 0.1 s, and the computer at its end."""

    def __init__(self, session, *, stamps_sending):
        self.clock = VirtualClock()
        stamps = FrameStamps(self.clock, stamps_sending=stamps_sending)
        late = DelayLine(DelaySpec(late_s=(LATE_S, LATE_S)), np.random.default_rng(1), self.clock)
        self.line = BusLine(ZenohBus("r1/can0", session=session, direct=True, now_ns=stamps.now_ns), late, stamps)
        self.computer = ZenohBus("r1/can0", session=session, direct=True)

    def run_to(self, time_s):
        """The frames that the computer has got by then, as identifier and stamp in seconds."""
        self.clock.advance_to(to_ns(time_s))
        self.line.deliver()
        frames = iter(lambda: self.computer.recv(timeout=0), None)
        return [(frame.arbitration_id, pytest.approx(frame.timestamp)) for frame in frames]

    def send(self, identifier):
        self.line.send(can.Message(arbitration_id=identifier, is_extended_id=False))


@pytest.fixture
def build():
    session = open_lockstep_session()
    lines = []

    def build(*, stamps_sending=False):
        lines.append(Line(session, stamps_sending=stamps_sending))
        return lines[-1]

    yield build
    for line in lines:
        line.computer.shutdown()
        line.line.shutdown()
    session.close()


@pytest.mark.parametrize(("stamps_sending", "stamps_s"), [(True, [1.0, 1.02]), (False, [1.2, 1.2])])
def test_late_frames_are_stamped_when_they_were_sent_or_when_they_arrive(build, stamps_sending, stamps_s):
    line = build(stamps_sending=stamps_sending)
    line.run_to(1.0)
    line.send(1)
    assert line.run_to(1.02) == []
    line.send(2)
    assert line.run_to(1.08) == []
    assert line.run_to(1.2) == [(1, stamps_s[0]), (2, stamps_s[1])]


def test_frames_that_are_on_their_way_when_the_line_is_cut_are_lost(build):
    line = build()
    line.send(1)
    line.line.break_down(LineFault.CUT)
    assert line.run_to(0.2) == []
    line.line.break_down(LineFault.NONE)
    line.send(2)
    assert line.run_to(0.3) == [(2, 0.3)]
