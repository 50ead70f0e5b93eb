import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.plugins.unit.teammates import (
    Doing,
    KnownTeammate,
    NearbyRobot,
    Teammates,
    may_be_near,
    near,
    receive_paths,
    receive_states,
    reckon,
)
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE, PlannedPath, RobotState
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

POSE = Pose2D(1.0, 2.0, 0.5)


def names(one):
    return [mate["name"] for mate in one.call("teammates", "others")]


def teamed(stage):
    """A robot that follows its mates, and its host."""
    one = stage()
    return one, one.host("teammates")


def test_other_robots_are_known_by_name_with_place_and_size(stage):
    one, _host = teamed(stage)
    one.say_state("r3", POSE, radius_m=0.3)
    one.say_state("r2", Pose2D(0.0, 0.0, 0.0))
    one.run(0.3)
    assert names(one) == ["r2", "r3"]
    assert one.call("teammates", "others")[1] == {
        "name": "r3",
        "pose": {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.5},
        "velocity": {"forward_m_s": 0.0, "left_m_s": 0.0, "yaw_rad_s": 0.0},
        "radius_m": 0.3,
    }


def test_a_teammate_that_is_silent_for_two_seconds_is_forgotten_and_comes_back(stage):
    one, _host = teamed(stage)
    one.run(0.02)
    one.run(1.0, lambda: one.say_state("r2", POSE))
    one.run(1.9)
    assert names(one) == ["r2"]
    one.run(0.5)
    assert names(one) == []
    one.say_state("r2", POSE)
    one.run(0.3)
    assert names(one) == ["r2"]


HERE = Point2D(1.0, 2.0)
PATH = [Point2D(1.0, 2.0), Point2D(4.0, 2.0)]


def mates(host, place=HERE, within_m=8.0):
    return host.manager.get("teammates").plugin.nearby(place, within_m)


def say_path(one, name, points, **more):
    one.publisher(ROBOT_PATH, robot=name).put(PlannedPath(robot=name, points=points, **more))


def test_a_lost_mate_is_an_obstacle_where_it_was_last_seen_and_forgotten_much_later(stage):
    one, host = teamed(stage)
    say_path(one, "r2", PATH)
    one.say_state("r2", POSE)
    one.run(2.5)
    (mate,) = mates(host)
    assert mate.doing is Doing.OBSTACLE
    assert mate.track.positions.tolist() == [[1.0, 2.0]]
    assert names(one) == []
    one.run(60.0)
    assert mates(host) == []


@pytest.mark.parametrize(("words", "keep_m"), [({"halted": True}, 0.2), ({"lost": "no idea"}, 0.7)])
def test_a_halted_mate_is_an_obstacle_and_a_lost_one_is_kept_away_from_by_half_a_metre_more(stage, words, keep_m):
    one, host = teamed(stage)
    say_path(one, "r2", PATH)
    one.publisher(ROBOT_STATE, robot="r2").put(RobotState(robot="r2", pose=POSE, radius_m=0.2, **words))
    (mate,) = mates(host)
    assert (mate.doing, mate.radius_m) == (Doing.OBSTACLE, keep_m)
    assert words.get("halted") or mate.track.keep_m == keep_m


S = 1_000_000_000
STALLED_S, FRESH_S = 4, 2


class Watched:
    """A mate r2 that speaks to the robot that watches it."""

    def __init__(self) -> None:
        self.known = KnownTeammate("r2", Teammates.Parameters(stalled_s=STALLED_S))

    def state(self, x_m: float, at_s: float, y_m: float = 0.0, yaw_rad: float = 0.0, **fields: object) -> None:
        state = RobotState(robot="r2", pose=Pose2D(x_m, y_m, yaw_rad), radius_m=0.2, **fields)  # type: ignore[arg-type]
        receive_states([(self.known, state)], round(at_s * S))

    def path(self, at_s: float, *points: tuple[float, float], **fields: float) -> None:
        path = PlannedPath(robot="r2", points=[Point2D(*point) for point in points], **fields)
        receive_paths([(self.known, path)], round(at_s * S))

    def at(self, at_s: float) -> NearbyRobot:
        (mate,) = reckon([self.known], round(at_s * S), FRESH_S * S)
        return mate


@pytest.mark.parametrize(
    ("yaw_rad", "velocity", "way"),
    [
        (0.0, Twist2D(0.38, 0.0, 0.0), (0.6, 0.0)),
        (math.pi, Twist2D(0.38, 0.0, 0.0), (-0.6, 0.0)),
        (0.0, Twist2D(0.0, 0.38, 0.0), (0.0, 0.6)),
        (math.pi / 2, Twist2D(0.0, -0.38, 0.0), (0.6, 0.0)),
        (0.3, Twist2D(-0.228, 0.304, 0.0), (0.6 * math.cos(0.3 + 2.2143), 0.6 * math.sin(0.3 + 2.2143))),
        (0.0, Twist2D(0.09, 0.0, 0.0), (0.0, 0.0)),  # it all but stands
    ],
)
def test_a_mate_that_rolls_without_a_path_goes_on_as_it_rolls_for_a_second_and_a_half(
    yaw_rad: float, velocity: Twist2D, way: tuple[float, float]
) -> None:
    mate = Watched()
    mate.state(3.0, 0, 2.0, yaw_rad, velocity=velocity)
    track = mate.at(0).track
    assert tuple(track.positions[0]) == (3.0, 2.0)
    assert tuple(track.positions[-1] - (3.0, 2.0)) == pytest.approx(way, abs=1e-3)
    assert track.speed_m_s == pytest.approx(math.hypot(velocity.forward_m_s, velocity.left_m_s))


def test_a_mate_that_falls_silent_while_it_rolls_is_an_obstacle_where_it_was() -> None:
    mate = Watched()
    mate.state(3.0, 0, velocity=Twist2D(0.38, 0.0, 0.0))
    assert mate.at(FRESH_S).doing is Doing.IDLE
    assert mate.at(FRESH_S + 0.001).doing is Doing.OBSTACLE
    assert mate.at(FRESH_S + 0.001).track.positions.tolist() == [[3.0, 0.0]]


def test_a_mate_under_way_that_does_not_move_is_an_obstacle_after_four_seconds() -> None:
    mate = Watched()
    mate.state(0.0, 0)
    mate.path(0, (0.0, 0.0), (4.0, 0.0))
    for at_s in (1, 2, 3, 4):
        mate.state(0.0, at_s)
        assert mate.at(at_s).doing is Doing.MOVING
    mate.state(0.1, 4.001)
    assert mate.at(4.001).doing is Doing.OBSTACLE, "a decimetre is no motion"
    mate.state(0.11, 5)
    assert mate.at(5).doing is Doing.MOVING


def test_a_mate_drives_as_fast_as_it_says_to_where_it_waits_for_others() -> None:
    mate = Watched()
    mate.state(0.0, 0)
    mate.path(0, (0.0, 0.0), (4.0, 0.0), held_at_m=2.0, speed_m_s=0.5)
    mate.state(1.0, 1)
    track = mate.at(1).track
    assert (track.speed_m_s, track.positions[track.held_at].tolist()) == (0.5, pytest.approx([2.0, 0.0]))


PLACE = st.builds(Point2D, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))
SPEED = st.floats(-2.0, 2.0)


@pytest.mark.slow
@settings(deadline=None, max_examples=200)
@given(PLACE, st.lists(PLACE, max_size=4), st.builds(Twist2D, SPEED, SPEED), PLACE, st.floats(0.01, 6.0))
def test_whoever_is_near_is_among_those_who_are_looked_at(
    at: Point2D, path: list[Point2D], velocity: Twist2D, place: Point2D, within_m: float
) -> None:
    mate = Watched()
    mate.state(at.x_m, 0, at.y_m, velocity=velocity)
    if path:
        mate.path(0, (at.x_m, at.y_m), *((point.x_m, point.y_m) for point in path))
    if near([mate.at(0)], place, within_m):
        assert may_be_near([mate.known], place, within_m) == [mate.known]
