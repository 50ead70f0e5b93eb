"""A robot that does not know its place but maps in a frame of its own explores by itself, to be found sooner."""

import pytest

from robrain.algorithms.navigation.frontier import find_frontiers
from robrain.plugins.behavior.explore import ExploreBehavior
from robrain.plugins.skill.mapper.frames import FrameMove
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.table.topics import ROBOT_STATE

TWO_ROOMS = (10.0, 4.0, (4.9, 0.0, 5.1, 1.4), (4.9, 2.6, 5.1, 4.0))
START = Pose2D(1.5, 2.0, 0.0)


@pytest.fixture
def lost(stage, room):
    """A robot that is not told where it starts, beside a coordinator that speaks."""
    one = stage(room(*TWO_ROOMS), r1=START)
    one.coordinator_speaks = True
    x_m, y_m = START.x_m, START.y_m
    host = one.host("explore", localisation={"start_known": False, "x_m": x_m, "y_m": y_m})
    return one, host


def explore(host) -> ExploreBehavior:
    return host.manager.get("explore").live_plugin()


def test_it_roams_though_there_is_a_coordinator_and_tells_that_it_is_lost(lost):
    one, host = lost
    states = one.inbox(ROBOT_STATE)
    one.run(3.0)
    assert host.board.frame.robot == "r1"
    assert one.truth().distance_m > 1.0
    assert one.truth().collisions == 0
    told = states.drain()[-1].message
    assert told.behavior == "explore alone"
    assert told.lost
    assert told.frame == host.board.frame


def test_it_takes_no_task_while_it_roams(lost):
    one, host = lost
    one.run(3.0)
    goal = explore(host).goal()
    assert goal is not None
    answer = one.offer(goal)
    assert not answer.accepted
    assert "does not know where it is" in answer.why


def test_it_goes_on_into_the_next_room_until_nothing_is_left(lost):
    one, host = lost
    one.run(20.0)
    assert one.truth().pose.x_m > 5.2
    assert one.truth().collisions == 0
    assert find_frontiers(host.manager.get("mapper").plugin.view().classes) == []
    assert host.board.behavior == "idle"


def test_a_place_that_it_chose_in_a_frame_that_it_has_left_is_no_goal_any_more(lost):
    one, host = lost
    one.run(3.0)
    assert host.board.behavior == "explore alone"
    frames = host.manager.get("mapper").live_plugin()._frames
    before = explore(host)._task
    frames.follow(FrameMove(MapFrame(1, "r9"), IDENTITY))
    one.run(0.3)
    assert host.board.frame == MapFrame(1, "r9")
    assert explore(host)._task is not before
    one.run(0.4)
    assert host.board.behavior == "explore alone", "it goes on in the new one"


@pytest.mark.parametrize("charging", [True, False])
def test_one_that_charges_stays(lost, charging):
    one, host = lost
    one.run(0.6)
    assert host.board.frame != ARENA
    host.board.battery = BatteryState(
        voltage_v=16.0, current_a=0.0, temperature_c=20.0, soc=0.5, remaining_j=1e5, charging=charging
    )
    assert explore(host)._may_roam() != charging
