import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.plugins.unit.teammates import (
    Doing,
    KnownTeammate,
    NearbyRobot,
    may_be_near,
    near,
    receive_paths,
    receive_states,
    reckon,
)
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE, PlannedPath, RobotState
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import ARENA, MapFrame

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


def test_a_robot_is_no_teammate_of_its_own(stage):
    one, _host = teamed(stage)
    one.say_state("r1", POSE)
    one.run(0.3)
    assert names(one) == []


def test_mates_that_do_not_know_where_they_are_are_counted_while_they_are_heard(stage):
    one = stage()
    teammates = one.host("teammates").manager.get("teammates").plugin
    one.say_state("r1", POSE)
    one.say_state("r2", None)
    one.say_state("r3", POSE)
    one.run(0.3)
    assert teammates.count() == 2
    one.run(2.5)
    assert teammates.count() == 0


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


def test_robots_beyond_the_most_are_not_followed_and_those_known_still_are(stage, monkeypatch):
    monkeypatch.setattr("robrain.plugins.unit.teammates.TEAMMATES_MAX", 2)
    one, _host = teamed(stage)
    for name in ("r4", "r2", "r3"):
        one.say_state(name, POSE)
        one.run(0.3)
    assert names(one) == ["r2", "r4"]
    one.say_state("r4", Pose2D(7.0, 0.0, 0.0))
    one.run(0.3)
    assert [mate["pose"]["x_m"] for mate in one.call("teammates", "others")] == [POSE.x_m, 7.0]


OWN = MapFrame(20, "r1")


def say_state_in(one, name, frame, pose=POSE):
    state = RobotState(robot=name, pose=pose, radius_m=0.2, frame=frame)
    one.publisher(ROBOT_STATE, robot=name).put(state)


def test_mates_are_known_in_the_map_frame_in_which_they_tell_their_poses(stage):
    one, host = teamed(stage)
    known = host.manager.get("teammates").plugin
    say_state_in(one, "r2", ARENA)
    say_state_in(one, "r3", OWN, Pose2D(3.0, 2.0, 0.0))
    one.run(0.3)
    assert names(one) == ["r2"]
    assert [mate.name for mate in known.in_frame(OWN)] == ["r3"]
    assert [mate.name for mate in known.in_frame(ARENA)] == ["r2"]
    assert known.in_frame(MapFrame(7, "r9")) == []
    host.board.frame = OWN
    assert names(one) == ["r3"]


def test_states_that_come_faster_than_they_are_needed_are_taken_in_seven_times_a_second(stage):
    """Each takes time to decode."""
    one = stage()
    known = one.host("teammates").manager.get("teammates").plugin
    ticks, heard = iter(range(1000)), set()

    def each():
        one.say_state("r2", Pose2D(float(next(ticks)), 0.0, 0.0))
        heard.update(mate.pose.x_m for mate in known.others())

    one.run(3.0, each)
    assert 15 <= len(heard) <= 21
    assert max(heard) > 140


S = 1_000_000_000
STALLED_S, FRESH_S = 4, 2


class Watched:
    """A mate r2 that speaks to the robot that watches it."""

    def __init__(self) -> None:
        self.known = KnownTeammate("r2", STALLED_S * S, 0.6)

    def state(self, x_m: float, at_s: float, y_m: float = 0.0, yaw_rad: float = 0.0, **fields: object) -> None:
        state = RobotState(robot="r2", pose=Pose2D(x_m, y_m, yaw_rad), radius_m=0.2, **fields)  # type: ignore[arg-type]
        receive_states([(self.known, state)], round(at_s * S))

    def path(self, at_s: float, *points: tuple[float, float], held_at_m: float | None = None) -> None:
        path = PlannedPath(robot="r2", points=[Point2D(*point) for point in points], held_at_m=held_at_m)
        receive_paths([(self.known, path)], round(at_s * S))

    def at(self, at_s: float) -> NearbyRobot:
        (mate,) = reckon([self.known], round(at_s * S), FRESH_S * S)
        return mate


@pytest.mark.parametrize(
    ("left_m", "doing"), [(0.0, Doing.IDLE), (0.2, Doing.IDLE), (0.3, Doing.MOVING), (1.0, Doing.MOVING)]
)
def test_a_mate_with_two_decimetres_of_way_left_has_arrived(left_m: float, doing: Doing) -> None:
    mate = Watched()
    mate.path(0, (0.0, 0.0), (1.0, 0.0))
    mate.state(1.0 - left_m, 0)
    assert mate.at(0).doing is doing


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


def test_a_mate_that_has_waited_for_others_is_given_time_to_set_out() -> None:
    mate = Watched()
    mate.state(0.0, 0)
    mate.path(0, (0.0, 0.0), (4.0, 0.0), held_at_m=0.0)
    mate.state(0.0, 20)
    assert mate.at(20).doing is Doing.MOVING
    mate.path(20, (0.0, 0.0), (4.0, 0.0))
    mate.state(0.0, 23)
    assert mate.at(23).doing is Doing.MOVING
    mate.state(0.0, 24.1)
    assert mate.at(24.1).doing is Doing.OBSTACLE
    mate.path(25, (0.0, 0.0), (4.0, 0.0))
    mate.state(0.0, 25.1)
    assert mate.at(25.1).doing is Doing.OBSTACLE, "to say the same again is no motion"


def test_where_a_path_ends_exactly_at_the_distance_the_mate_is_near() -> None:
    mate = Watched()
    mate.path(0, (20.0, 0.0), (4.0, 0.0))
    mate.state(20.0, 0)
    assert near([mate.at(0)], Point2D(1.0, 0.0), 3.0)
    assert not near([mate.at(0)], Point2D(1.0, 0.0), 2.99)
    mate.path(1, (20.0, 0.0), (25.0, 0.0))
    mate.state(20.0, 1)
    assert not near([mate.at(1)], Point2D(1.0, 0.0), 3.0)


def test_a_mate_that_waits_for_nobody_goes_to_the_end_of_its_way_as_fast_as_it_says_or_as_robots_usually_do() -> None:
    mate = Watched()
    mate.state(0.0, 0)
    for speed_m_s, expected_m_s in ((0.0, 0.6), (0.3, 0.3), (-1.0, 0.6)):
        points = [Point2D(0.0, 0.0), Point2D(4.0, 0.0)]
        receive_paths([(mate.known, PlannedPath(robot="r2", points=points, speed_m_s=speed_m_s))], 0)
        track = mate.at(0).track
        assert track.speed_m_s == expected_m_s
        assert track.held_at == len(track.positions) - 1
        assert mate.at(0).bound == Point2D(4.0, 0.0)


@pytest.mark.parametrize(("held_at_m", "held_at"), [(0.0, 0), (1.5, 15), (3.0, 30), (9.0, 40), (-1.0, 0)])
def test_a_mate_waits_on_its_way_where_it_says(held_at_m: float, held_at: int) -> None:
    mate = Watched()
    mate.state(0.0, 0)
    mate.path(0, (0.0, 0.0), (4.0, 0.0), held_at_m=held_at_m)
    assert mate.at(0).track.held_at == held_at


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


@pytest.mark.parametrize(("from_x_m", "to_x_m"), [(0.0, 4.0), (4.0, 0.0)])
@pytest.mark.parametrize(
    ("x_m", "y_m", "is_looked_at"),
    [
        (-1.9, 1.0, True),
        (-2.2, 1.0, False),
        (5.9, 1.0, True),
        (6.2, 1.0, False),
        (2.0, -0.9, True),
        (2.0, -1.2, False),
        (2.0, 2.9, True),
        (2.0, 3.2, False),
    ],
)
def test_who_is_and_is_bound_beyond_reach_is_not_looked_at(
    from_x_m: float, to_x_m: float, x_m: float, y_m: float, *, is_looked_at: bool
) -> None:
    mate = Watched()
    mate.path(0, (from_x_m, 1.0), (to_x_m, 1.0))
    mate.state(from_x_m, 0, 1.0)
    assert bool(may_be_near([mate.known], Point2D(x_m, y_m), 2.0)) is is_looked_at
