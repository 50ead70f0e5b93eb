from robrain.plugins.unit.teammates import Doing
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.table.topics import ROBOT_PATH, ROBOT_STATE

POSE = Pose2D(1.0, 2.0, 0.5)


def names(one):
    return [mate["name"] for mate in one.call("teammates", "others")]


def test_other_robots_are_known_by_name_with_place_and_size(stage):
    one = stage()
    one.host("teammates")
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
    one = stage()
    one.host("teammates")
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
    one = stage()
    one.host("teammates")
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
    return host.manager.get("teammates").plugin.mates(place, within_m)


def say_path(one, name, points, **more):
    one.publisher(ROBOT_PATH, robot=name).put(PlannedPath(robot=name, points=points, **more))


def test_a_mate_with_a_path_is_under_way_along_what_is_left_of_it(stage):
    one = stage()
    host = one.host("teammates")
    say_path(one, "r2", PATH, claim=Claim(priority=3), speed_m_s=0.4)
    one.say_state("r2", Pose2D(2.0, 2.0, 0.0))
    (mate,) = mates(host)
    assert (mate.doing, mate.claim.priority, mate.track.speed_m_s) == (Doing.MOVING, 3, 0.4)
    assert tuple(mate.track.positions[0]) == (2.0, 2.0)
    assert abs(mate.track.positions[-1][0] - 4.0) < 0.05
    assert mate.track.positions.shape[0] in (21, 22)


def test_a_lost_mate_is_an_obstacle_where_it_was_last_seen_and_forgotten_much_later(stage):
    one = stage()
    host = one.host("teammates")
    say_path(one, "r2", PATH)
    one.say_state("r2", POSE)
    one.run(2.5)
    (mate,) = mates(host)
    assert mate.doing is Doing.OBSTACLE
    assert mate.track.positions.tolist() == [[1.0, 2.0]]
    assert names(one) == []
    one.run(60.0)
    assert mates(host) == []


def test_a_halted_mate_is_an_obstacle_although_it_speaks(stage):
    one = stage()
    host = one.host("teammates")
    say_path(one, "r2", PATH)
    one.publisher(ROBOT_STATE, robot="r2").put(RobotState(robot="r2", pose=POSE, radius_m=0.2, halted=True))
    assert mates(host)[0].doing is Doing.OBSTACLE


def test_one_that_does_not_know_where_it_is_is_kept_away_from_by_half_a_metre_more(stage):
    one = stage()
    host = one.host("teammates")
    say_path(one, "r2", PATH)
    one.publisher(ROBOT_STATE, robot="r2").put(RobotState(robot="r2", pose=POSE, radius_m=0.2, lost="no idea"))
    (mate,) = mates(host)
    assert (mate.doing, mate.radius_m, mate.track.keep_m) == (Doing.OBSTACLE, 0.7, 0.7)


def test_robots_beyond_the_most_are_not_followed_and_those_known_still_are(stage, monkeypatch):
    monkeypatch.setattr("robrain.plugins.unit.teammates.TEAMMATES_MAX", 2)
    one = stage()
    one.host("teammates")
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
    one = stage()
    host = one.host("teammates")
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
