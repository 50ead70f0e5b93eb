import math

import pytest

from robrain.protocol.messages.team.arena_messages import ARENA_SCAN


def test_millimetres_of_the_wire_are_metres_and_no_return_is_the_maximum(stage):
    one = stage()
    host = one.host("scan")
    one.scan([1.25, 0.0, 0.001, 5.999], range_max_m=6.0)
    one.run(0.02)
    scan = host.manager.get("scan").plugin.latest()
    assert scan.ranges_m.tolist() == [1.25, 6.0, 0.001, 5.999]
    assert scan.range_max_m == 6.0
    assert scan.angles_rad == pytest.approx([-math.pi, -math.pi / 2, 0.0, math.pi / 2])
    assert scan.stamp_ns == 0
    assert one.call("scan", "nearest_m") == 0.001


def test_a_robot_hears_its_own_lidar_only(stage):
    one = stage()
    host = one.host("scan")
    one.scan([1.0], robot="r2")
    one.run(0.1)
    assert host.manager.get("scan").plugin.latest() is None


def test_a_turn_without_beams_of_a_lidar_that_is_mounted_elsewhere_is_no_fault(stage):
    one = stage()
    host = one.host("scan", scan={"mount": {"x_m": 0.1}})
    one.publisher(ARENA_SCAN, robot="r1").put_bytes(
        b'{"robot":"r1","angle_min_rad":0,"angle_increment_rad":0.1,"range_max_m":6,"ranges_mm":[]}'
    )
    one.run(0.1)
    assert host.manager.get("scan").state == "active"
    assert host.manager.get("scan").plugin.latest().ranges_m.size == 0


def test_ranges_of_a_lidar_beside_the_centre_are_converted_to_the_centre(stage):
    one = stage()
    host = one.host("scan", scan={"mount": {"x_m": 0.1}})
    one.scan([2.0] * 4)  # behind, right, ahead, left of the lidar
    one.run(0.02)
    scan = host.manager.get("scan").plugin.latest()
    assert sorted(scan.ranges_m.tolist()) == pytest.approx([1.9, math.hypot(2.0, 0.1), math.hypot(2.0, 0.1), 2.1])
