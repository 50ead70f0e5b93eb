from robrain.agent.authoring.testing import PluginBench
from robrain.protocol.model.geometry import Point2D, Pose2D

A, B = {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.5}, {"x_m": 4.0, "y_m": 2.0, "yaw_rad": None}


def test_chargers_of_the_manifest_are_known_and_more_are_learned():
    with PluginBench(load=["home"], parameters={"home": {"chargers": [A]}}) as bench:
        assert bench.call("home", "chargers") == [A]
        bench.call("home", "learn", B)
        bench.call("home", "learn", {"x_m": 1.1, "y_m": 2.1})  # the first one again
        assert bench.call("home", "chargers") == [A, B]
        assert bench.host.board.chargers == (Point2D(1.0, 2.0), Point2D(4.0, 2.0))


def test_the_start_is_known_once_the_robot_knows_where_it_is():
    with PluginBench(load=["home"]) as bench:
        assert bench.call("home", "start") is None
        bench.host.board.T_arena_odom = Pose2D(3.0, 4.0, 1.0)
        assert bench.plugin("home").start() == Point2D(3.0, 4.0)
