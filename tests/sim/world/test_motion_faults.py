"""The whole stack, and a bus that is cut or a lidar that freezes in the middle of an exploration."""

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_PLUGINS
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.firmware.bus_line import LineFault
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow


@pytest.fixture
def team():
    """Two robots that explore, for four seconds so far, and all that they tell the team."""
    run = LockstepRun(Scenario.builtin("depot").replace(robots=2, motes=0, seed=3).world())
    watcher = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP)
    run.events = Inbox(100_000, every=True)
    watcher.subscribe(run.events, ROBOT_EVENT)
    run.watcher = watcher
    ticks(run, 4.0)
    assert speed_m_s(run, "r1") > 0.2
    yield run
    watcher.close()
    run.close()


def ticks(run, seconds):
    for _ in range(round(seconds / 0.02)):
        run.tick()


def truth(run, name):
    return next(robot for robot in run.truth.robots if robot.robot == name)


def speed_m_s(run, name):
    before = truth(run, name).distance_m
    ticks(run, 0.5)
    return (truth(run, name).distance_m - before) / 0.5


def told(run, plugin, event):
    return [
        each.message.value
        for each in run.events.drain()
        if each.names["robot"] == "r1" and (each.message.plugin, each.message.event) == (plugin, event)
    ]


def why(run, plugin):
    infos = run.watcher.ask(ROBOT_PLUGINS, robot="r1")
    return next(f"{info.state}: {info.why}" for info in infos if info.name == plugin)


def test_a_robot_whose_bus_is_cut_stands_until_it_is_whole_again_and_the_others_go_on(team):
    team.arena.robot("r1").bus.break_down(LineFault.CUT)
    ticks(team, 0.5)
    assert why(team, "mocdevice").startswith("faulted: BusFault: no encoder frame for 0.4")
    assert told(team, "mocdevice", "condition")[0]["ok"] is False
    ticks(team, 0.5)
    place, others_m = truth(team, "r1").pose, truth(team, "r2").distance_m
    ticks(team, 5.0)
    assert truth(team, "r1").pose == place
    assert truth(team, "r2").distance_m > others_m + 1.0
    team.arena.robot("r1").bus.break_down(LineFault.NONE)
    before_m = truth(team, "r1").distance_m
    ticks(team, 10.0)
    assert truth(team, "r1").distance_m > before_m + 1.0
    believed = team.hosts[0].manager.get("localisation").plugin.pose()
    assert believed.distance_m(truth(team, "r1").pose) < 0.3
    assert truth(team, "r1").collisions == 0


def test_a_robot_whose_lidar_freezes_stands_and_maps_nothing_of_it(team):
    team.arena.robot("r1").lidar.is_frozen = True
    ticks(team, 1.0)
    assert "the lidar is frozen" in told(team, "scan", "trouble")[0]
    ticks(team, 0.5)
    place = truth(team, "r1").pose
    ticks(team, 5.0)
    assert truth(team, "r1").pose == place
    assert truth(team, "r1").collisions == 0
    team.arena.robot("r1").lidar.is_frozen = False
    ticks(team, 10.0)
    assert truth(team, "r1").pose.distance_m(place) > 0.5
