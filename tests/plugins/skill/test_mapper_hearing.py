"""What a mapper believes of what mates tell, and how a lost one finds its place by it."""

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import NO_DRIFT, LocalPose, OwnMap
from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import joined_message, to_message
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, UNKNOWN
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import STAMP_MAX
from tests.algorithms.mapping.lidar_floor import ROOM
from tests.plugins.unit.frame_scene import PLACES, ROOM_CLASSES, T_OWN_FLOOR, WIDE

GRID = {"resolution_m": 0.1, "origin_x_m": -12.0, "origin_y_m": -12.0, "width_m": 24.0, "height_m": 24.0}
WHY = "it was carried"


def floor_at(column, robot, submap, observed_ms):
    """A patch of 1 × 1 m of floor."""
    cells = PatchCells(8, column, np.full((10, 10), FREE, np.int8), observed_ms)
    return to_message(robot, WIDE, cells, submap)


def known(grid, column):
    return grid.classes()[12, column + 4] == FREE


def begun_at_3_s(stage):
    """A mapper that starts 3 s after the clock, and a mate r2 that was there."""
    one = stage()
    one.run(3.0)
    host = one.host("mapper", mapper=GRID)
    one.wire.token(ROBOT_ALIVE, robot="r2")
    one.run(0.6)
    return one, host, one.publisher(ROBOT_MAP, robot="r2")


@pytest.mark.parametrize(
    ("robot", "submap", "is_taken"),
    [("r1", 2_900, True), ("r1", 3_100, False), ("r2", 3_100, True), ("r3", 3_100, True)],
)
def test_a_submap_of_this_robot_that_it_cannot_have_made_before_is_refused(stage, robot, submap, is_taken):
    one, host, mates = begun_at_3_s(stage)
    mates.put(joined_message("r2", WIDE, [floor_at(0, robot, submap, 3_100)]))
    one.run(0.6)
    mapper = host.manager.get("mapper").plugin
    assert known(host.board.map, 0) == is_taken
    codes = [(each.code, each.count) for each in mapper.env.wire.refusals.counts()]
    assert codes == ([] if is_taken else [("not_plausible", 1)])


def test_a_start_is_held_only_against_what_was_seen_before_it(stage):
    one, host, mates = begun_at_3_s(stage)
    seen = [(100, 2_000), (200, 3_390), (300, 3_450), (3_200, 3_300), (3_200, 3_500)]
    parts = [floor_at(16 * n, "r2", submap + n, seen_ms) for n, (submap, seen_ms) in enumerate(seen)]
    mates.put(joined_message("r2", WIDE, parts))
    mates.put(floor_at(96, "r2", 500, 2_000))
    one.run(0.6)
    assert [known(host.board.map, 16 * n) for n in range(5)] == [True] * 5
    assert [known(host.board.shared(OwnMap).map_of_others, 16 * n) for n in range(5)] == [
        True,
        True,
        False,
        False,
        False,
    ]
    assert not known(host.board.shared(OwnMap).map_of_others, 96), "only whole maps are asked for at the start"
    assert np.count_nonzero(host.board.shared(OwnMap).map_of_others.classes() != UNKNOWN) == 200


class Lost:
    """A robot r1 that maps ROOM in a frame of its own; r2 has mapped it in the arena frame."""

    def __init__(self, stage):
        self.one = stage()
        self.host = self.one.host("mapper", mapper=GRID)
        self.board = self.host.board
        self.board.lost = WHY
        self.board.pose_covariance = tuple(np.diag((0.01, 0.01, 0.001)).ravel().tolist())
        self.told = self.one.inbox(ROBOT_MAP, robot="r1")
        self.one.wire.token(ROBOT_ALIVE, robot="r2")
        self.one.run(0.6)
        self.say = self.one.publisher(ROBOT_MAP, robot="r2")

    def mates_map(self):
        cells = PatchCells(0, 0, ROOM_CLASSES, 500)
        self.say.put(to_message("r2", WIDE, cells, 7))

    def scan(self, place, seconds=0.6, each=lambda: None):
        local = T_OWN_FLOOR.compose(place)
        self.board.shared(OwnMap).local_pose = LocalPose(local, 1, NO_DRIFT, STAMP_MAX, True, 0.1, WHY)
        ranges_m = ROOM.ranges_m(place).tolist()

        def tick():
            each()
            self.one.stand_and_scan(ranges_m)

        self.one.run(seconds, tick)
        return self.board.frame

    def way(self, each=lambda: None):
        return [self.scan(place, each=each) == ARENA for place in (*PLACES, *PLACES[:2])]

    @property
    def T_arena_floor(self):
        return self.board.shared(OwnMap).local_map.T_arena_local.compose(T_OWN_FLOOR)


@pytest.mark.parametrize(("mate", "joins"), [(Pose2D(4.5, 3.0, 0.0), False), (Pose2D(11.0, 11.0, 0.0), True)])
def test_where_a_mate_would_stand_that_is_not_there_a_lost_robot_does_not_join(stage, mate, joins):
    """From each of its places it sees the walls behind the mate's; the other mate's place is out of sight."""
    robot = Lost(stage)
    robot.mates_map()
    assert any(robot.way(lambda: robot.one.say_state("r2", mate))) == joins
