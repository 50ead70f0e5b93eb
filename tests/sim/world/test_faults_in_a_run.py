"""A robot whose hardware breaks: the fault is named, the robot is safe, the team is told, and the others go on."""

import math

import msgspec
import pytest

from robrain.agent.plugin import PluginState
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario

BREAKS_S = 6.0


class BrokenRun:
    """Two robots explore; something of r1 breaks after six seconds."""

    def __init__(self, kind, until_s=None):
        fault = FaultSpec(robot="r1", kind=kind, at_s=BREAKS_S, until_s=until_s)
        scenario = Scenario.builtin("depot").replace(robots=2, motes=6, seed=4, faults=(fault,))
        self.run = LockstepRun(scenario.world())
        wire = Endpoint(self.run.session, "default", self.run.clock, Drive.LOCKSTEP)
        self.wire = wire
        self.states, self.summaries, self.said = Inbox(every=True), Inbox(every=True), Inbox(every=True)
        wire.subscribe(self.states, ROBOT_STATE, robot="r1")
        wire.subscribe(self.summaries, COORDINATOR_STATE)
        wire.subscribe(self.said, ROBOT_LOG, robot="r1")
        wire.subscribe(self.said, ROBOT_EVENT, robot="r1")
        self.poses = {}
        self.state = None
        self.told = {"r1": set(), "r2": set()}
        """The plugins of each robot that the coordinator has called faulted."""
        self.words = []
        """What the robot has said in its log and by events, as text."""

    def go(self, until_s):
        while self.run.sim_time_s < until_s - 1e-9:
            self.run.tick()
            for received in self.states.drain():
                self.state = received.message
            for received in self.summaries.drain():
                for robot in received.message.robots:
                    self.told[robot.name] |= {fault.plugin for fault in robot.faulted}
            for received in self.said.drain():
                self.words.append(str(received.message))
            if round(self.run.sim_time_s * 50) % 10 == 0:
                self.poses[round(self.run.sim_time_s, 2)] = {each.robot: each.pose for each in self.run.truth.robots}

    def moved_m(self, robot, since_s, until_s):
        return self.poses[since_s][robot].distance_m(self.poses[until_s][robot])

    def close(self):
        self.wire.close()
        self.run.close()


@pytest.fixture
def broken():
    opened = []

    def start(kind, until_s=None):
        opened.append(BrokenRun(kind, until_s))
        opened[-1].go(BREAKS_S)
        assert opened[-1].state.faulted == []
        return opened[-1]

    yield start
    for each in opened:
        each.close()


@pytest.mark.slow
def test_a_robot_that_has_lost_its_motors_says_so_and_stands_while_the_other_goes_on(broken):
    run, plugin = broken(FaultKind.MOTORS_FAIL), "mocdevice"
    run.go(BREAKS_S + 1.0)
    assert any(f"source='{plugin}', text='does not run" in words for words in run.words)
    run.go(BREAKS_S + 6.0)
    assert run.moved_m("r1", BREAKS_S + 1.0, BREAKS_S + 6.0) < 0.02
    assert run.moved_m("r2", BREAKS_S + 1.0, BREAKS_S + 6.0) > 0.5
    assert plugin in run.told["r1"]
    assert run.told["r2"] == set()


@pytest.mark.slow
def test_a_robot_whose_battery_lies_does_not_believe_it(broken):
    run = broken(FaultKind.BATTERY_LIES)
    run.go(BREAKS_S + 5.0)
    before = run.state.battery
    assert any("implausible" in words for words in run.words)
    assert "frozen" in before.implausible
    run.go(BREAKS_S + 13.0)
    # It says to be full; what the robot counts on falls by more than the robot can have drawn meanwhile.
    assert run.state.battery.remaining_low_j < before.remaining_low_j - 8.0 * 10.0


@pytest.mark.slow
def test_a_base_station_that_floods_is_named_and_the_robot_goes_on(broken):
    run = broken(FaultKind.MOTE_BASE_FLOODS)
    run.go(BREAKS_S + 10.0)
    assert any("flood" in words for words in run.words)
    assert run.moved_m("r1", BREAKS_S, BREAKS_S + 10.0) > 0.5
    assert [fault.plugin for fault in run.state.faulted] in ([], ["mote_base"], ["mote_base", "snw_exploration"])


DEPOT = Scenario.builtin("depot").replace(robots=2, motes=0, seed=4)


def carried_off(place_m):
    return FaultSpec(robot="r1", kind=FaultKind.CARRIED_OFF, at_s=1.0, place_m=place_m, yaw_rad=2.0)


@pytest.mark.slow
def test_a_robot_that_is_carried_off_is_elsewhere_at_once_and_its_wheels_have_not_turned():
    start = DEPOT.world().robots[1].start
    place = Pose2D(start.x_m, start.y_m, 2.0)  # where r2 starts is room for a robot; r2 itself drives away
    fault = msgspec.structs.replace(carried_off((place.x_m, place.y_m)), at_s=8.0)
    run = LockstepRun(DEPOT.replace(faults=(fault,)).world())
    try:
        while run.sim_time_s < 8.0 - 0.03:
            run.tick()
        before = next(truth for truth in run.truth.robots if truth.robot == "r1")
        believed = run.hosts[0].manager.get("localisation").plugin.pose()
        for _ in range(3):
            run.tick()
        after = next(truth for truth in run.truth.robots if truth.robot == "r1")
        assert before.pose.distance_m(place) > 0.5
        assert after.pose.distance_m(place) < 0.1
        assert abs(math.remainder(after.pose.yaw_rad - place.yaw_rad, math.tau)) < 0.1
        assert after.distance_m - before.distance_m < 0.1
        assert run.hosts[0].manager.get("localisation").plugin.pose().distance_m(believed) < 0.2
    finally:
        run.close()


RAISES = ["localisation", "mapper", "planner", "driver", "teammates", "battery", "energy", "explore"]


@pytest.mark.slow
def test_a_stock_plugin_that_raises_once_is_restarted_and_its_robot_goes_on():
    """A robot for each of the plugins."""
    run = LockstepRun(Scenario.builtin("depot").replace(robots=len(RAISES), motes=0, seed=2).world())
    try:
        while run.sim_time_s < 3.0:
            run.tick()
        plugins = [host._registry.plugins[plugin] for host, plugin in zip(run.hosts, RAISES, strict=True)]
        for broken in plugins:
            broken.fault(ZeroDivisionError("once"))
        run.tick()
        before = [robot.distance_m for robot in run.truth.robots]
        while run.sim_time_s < 13.0:
            run.tick()
        assert [(one.state, one.restarts) for one in plugins] == [(PluginState.ACTIVE, 1)] * len(RAISES)
        assert min(now.distance_m - then for now, then in zip(run.truth.robots, before, strict=True)) > 1.0
        assert run.arena.collisions == 0
    finally:
        run.close()
