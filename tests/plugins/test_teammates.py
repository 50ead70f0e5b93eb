from robrain.protocol.model.geometry import Pose2D

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


def test_a_robot_that_does_not_know_where_it_is_is_none_to_avoid(stage):
    one = stage()
    one.host("teammates")
    one.say_state("r2", None)
    one.run(0.3)
    assert names(one) == []


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


def test_only_the_latest_word_of_a_teammate_counts(stage):
    one = stage()
    one.host("teammates")
    for x_m in (1.0, 2.0, 3.0):
        one.say_state("r2", Pose2D(x_m, 0.0, 0.0))
    one.run(0.3)
    (mate,) = one.call("teammates", "others")
    assert mate["pose"]["x_m"] == 3.0
