"""Frames, scans and agents that are late, by the seed."""

import math

import numpy as np
import pytest

from robrain import Scenario
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.firmware.disturbance import DelayLine, DelaySpec, DisturbanceSpec, FrameDelaySpec
from robrain.sim.lockstep.lockstep import LockstepRun

TICK_NS = to_ns(0.02)
PLAIN = Scenario.builtin("arena_small").replace(robots=2)
SCANS = DelaySpec(per_minute=30, duration_s=(0.3, 0.9), late_s=(0.0, 0.15))


def rng(seed=1):
    return np.random.default_rng(seed)


def sent_through(spec, ticks=3000, seed=1):
    """A number sent each tick: (tick it was sent, tick it arrived), in order of arrival; by what the line says."""
    clock = VirtualClock()
    line = DelayLine(spec, rng(seed), clock)
    arrived = []
    for tick in range(ticks):
        clock.advance_to(tick * TICK_NS)
        line.put(tick)
        for sent_ns, number in line.arrivals():
            assert sent_ns == number * TICK_NS
            arrived.append((number, tick))
    return arrived


def test_what_is_late_arrives_in_order_and_within_its_time():
    arrived = sent_through(DelaySpec(late_s=(0.1, 0.3)))
    assert [number for number, _ in arrived] == list(range(len(arrived)))
    late_s = [(tick - number) * 0.02 for number, tick in arrived]
    assert min(late_s) >= 0.1
    assert 0.25 <= max(late_s) <= 0.32
    assert len({tick for _, tick in arrived}) < len(arrived), "some arrive together"


def test_what_waits_in_a_pause_arrives_together_after_it():
    spec = DelaySpec(per_minute=6, duration_s=(0.2, 1.0))
    arrived = sent_through(spec)
    late = [(number, tick - number) for number, tick in arrived if tick > number]
    bursts = {number + ticks for number, ticks in late}
    assert 3 <= len(bursts) <= 12
    for burst in bursts:
        together = [number for number, tick in arrived if tick == burst]
        assert together == list(range(together[0], burst + 1))
        assert 0.18 <= 0.02 * (len(together) - 1) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("stamped_at", list(StampedAt))
def test_odometry_at_the_time_of_a_frame_is_right_however_late_the_frame_was(stamped_at):
    frames = FrameDelaySpec(per_minute=60, duration_s=(0.1, 0.35), stamped_at=stamped_at)
    scenario = PLAIN.replace(robots=1, disturbance=DisturbanceSpec(can=frames))
    run = LockstepRun(scenario.world())
    try:
        start = run.world.robots[0].start
        odometry = run.hosts[0].manager.get("mocdevice").plugin
        truth: dict[int, Pose2D] = {}
        lags_s, errors_m, speeds_m_s = [], [], []
        for _ in range(400):
            run.tick()
            now_ns = run.clock.now_ns()
            truth[now_ns] = start.inverse().compose(run.truth.robots[0].pose)
            until_ns = odometry.odometry_until_ns()
            assert until_ns <= now_ns
            lags_s.append((now_ns - until_ns) / 1e9)
            for stamp_ns in (until_ns, until_ns - 10 * TICK_NS):
                if stamp_ns in truth:
                    errors_m.append(truth[stamp_ns].distance_m(odometry.pose_at(stamp_ns)))
            speeds_m_s.append(math.hypot(odometry.velocity().forward_m_s, odometry.velocity().left_m_s))
    finally:
        run.close()
    assert max(lags_s[5:]) > 0.2
    assert lags_s.count(0.0) > 200
    assert max(speeds_m_s) > 0.3
    assert len(errors_m) > 400
    assert max(errors_m) < 0.003


@pytest.mark.slow
def test_late_scan_is_stamped_with_the_time_at_which_it_was_measured():
    run = LockstepRun(PLAIN.replace(robots=1, disturbance=DisturbanceSpec(scan=SCANS)).world())
    inbox = Inbox(every=True)
    run._watcher.subscribe(inbox, ARENA_SCAN)
    try:
        late_s, stamps_ns = [], []
        for _ in range(900):
            run.tick()
            for received in inbox.drain():
                late_s.append((run.clock.now_ns() - received.message.stamp_ns) / 1e9)
                stamps_ns.append(received.message.stamp_ns)
    finally:
        run.close()
    assert max(late_s) > 0.3
    assert max(late_s) <= 0.9 + 0.15 + 0.02
    assert set(np.diff(stamps_ns).tolist()) == {to_ns(0.2)}
