import math

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NO_DRIFT, LocalPose, OwnMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.plugins.skill.mapper.mapper import Mapper
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.ranges import STAMP_MAX

GRID = {"resolution_m": 0.1, "origin_x_m": -8.0, "origin_y_m": -8.0, "width_m": 16.0, "height_m": 16.0}


def view(host):
    return host.manager.get("mapper").plugin.view()


def class_at(seen, x_m, y_m):
    return seen.classes[seen.geometry.cell_of(x_m, y_m)]


def lies_at(T_local_odom, sigma_m=0.03):
    """What localisation would say: scans may be mapped as they come."""
    return LocalPose(T_local_odom, 0, NO_DRIFT, STAMP_MAX, True, sigma_m)


def mapping(stage, *others):
    """A robot that maps, and its host."""
    one = stage()
    return one, one.host("mapper", *others, mapper=GRID)


def test_a_room_of_known_size_is_mapped_as_such(stage):
    one, host = mapping(stage, "localisation")
    ranges_m = [min(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 5.0) for a in np.linspace(-np.pi, np.pi, 721)[:-1]]
    one.run(1.0, lambda: one.stand_and_scan(ranges_m))
    seen = view(host)
    for place in ((0.0, 0.0), (1.8, 0.0), (-1.5, -1.5)):
        assert class_at(seen, *place) == FREE
    for place in ((2.05, 0.0), (-2.05, 1.0), (0.5, 2.05)):
        assert class_at(seen, *place) == OCCUPIED
    for place in ((2.5, 0.0), (-3.0, -3.0), (0.0, 7.0)):
        assert class_at(seen, *place) == UNKNOWN


def test_an_area_smaller_than_a_cell_has_one():
    assert Mapper.Parameters(resolution_m=1.0, width_m=0.2, height_m=0.2).geometry().shape == (1, 1)


def test_a_map_on_another_grid_is_refused_with_one_word_in_the_log(stage, caplog):
    one, host = mapping(stage, "localisation")
    patch = MapPatch(
        robot="r2",
        resolution_m=0.05,
        origin_x_m=0.0,
        origin_y_m=0.0,
        width=4,
        height=4,
        row=0,
        column=0,
        rows=1,
        columns=1,
        observed_ms=5,
        cells=b"",
    )
    one.wire.token(ROBOT_ALIVE, robot="r2")
    for _ in range(3):
        one.publisher(ROBOT_MAP, robot="r2").put(patch)
        one.run(0.6)
    assert not np.any(view(host).classes != UNKNOWN)
    refused = [record.getMessage() for record in caplog.records if "cannot be merged" in record.getMessage()]
    assert len(refused) == 1
    assert "r2 maps" in refused[0]
    mapper = host.manager.get("mapper").plugin
    assert [(each.topic, each.code, each.count) for each in mapper.env.wire.refusals.counts()] == [
        ("robot_map", "not_plausible", 3)
    ]
    assert one.infos()["mapper"].state == "active"


def test_scans_are_left_out_while_the_place_is_not_sure_and_taken_in_again_later(stage):
    one, host = mapping(stage)
    paused = one.inbox(ROBOT_EVENT, robot="r1", plugin="mapper", event="paused")
    board = host.board
    board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 0.0, 0.0), sigma_m=3.0)
    board.pose_covariance = (9.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.01)
    one.run(1.0, lambda: one.stand_and_scan([2.0] * 90))
    assert not np.any(view(host).classes != UNKNOWN)
    assert one.call("mapper", "counters")["scans_skipped"] > 10
    # Where the own map lies in the arena may be as unsure as it likes: closures move it, and only who maps finds any.
    board.shared(OwnMap).local_pose = lies_at(Pose2D(0.0, 0.0, 0.0))
    one.run(1.0, lambda: one.stand_and_scan([2.0] * 90))
    assert np.any(view(host).classes == OCCUPIED)
    said = [received.message.value for received in paused.drain()]
    assert len(said) == 2
    assert "not sure enough" in said[0]
    assert said[1] == ""


def test_memory_is_bounded_whatever_the_others_send_and_drops_are_counted(stage):
    one, host = mapping(stage, "localisation")
    grid = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    other = OccupancyGrid(grid)
    other.merge_patch(0, 0, np.full((2, 2), FREE, np.int8), 1)
    patch, publisher = (
        to_message("r2", grid, PatchCells(0, 0, other.classes(), int(other.stamp_ms.max()))),
        one.publisher(ROBOT_MAP, robot="r2"),
    )
    for _ in range(4096 + 100):
        publisher.put(patch)
    one.run(0.6)
    assert one.call("mapper", "counters")["patches_dropped"] == 100
    assert view(host).classes.shape == grid.shape


def hall(robot, observed_ms):
    """A patch of 4 × 4 m of floor."""
    grid = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    other = OccupancyGrid(grid)
    other.merge_patch(0, 0, np.full((40, 40), FREE, np.int8), observed_ms)
    return to_message(robot, grid, PatchCells(0, 0, other.classes(), int(other.stamp_ms.max())))


WRAPPED_MS = 2**31 - 1
"""A millisecond before 0, as times in patches have 31 bits."""


@pytest.mark.parametrize(("observed_ms", "is_taken"), [(500, True), (5_900, True), (20_000, False), (WRAPPED_MS, True)])
def test_patches_from_the_future_are_ignored(stage, observed_ms, is_taken):
    one, host = mapping(stage, "localisation")
    one.wire.token(ROBOT_ALIVE, robot="r2")
    one.run(1.0)
    one.publisher(ROBOT_MAP, robot="r2").put(hall("r2", observed_ms))
    one.run(0.6)
    assert np.any(view(host).classes == FREE) == is_taken
    assert one.infos()["mapper"].state == "active"


def test_patches_of_an_absent_robot_are_ignored_until_it_is_there(stage):
    one, host = mapping(stage, "localisation")
    one.run(1.0)
    for is_taken in (False, True):
        one.publisher(ROBOT_MAP, robot="r2").put(hall("r2", 500))
        one.run(0.6)
        assert np.any(view(host).classes == FREE) == is_taken
        one.wire.token(ROBOT_ALIVE, robot="r2")
        one.run(0.6)
