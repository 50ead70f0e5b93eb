"""What a localiser forgets when its frame leaves the arena frame or joins it, and what it holds its start against."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.localiser import DivergenceSpec, Localiser, LocaliserSpec
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from tests.algorithms.mapping.lidar_floor import ROOM, ROOM_PLACES, local_map

TRUE = Pose2D(2.3, 4.1, 0.8)
ELSEWHERE = Pose2D(6.8, 1.0, 2.2)
ROOM_MAP = ROOM.mapped(*ROOM_PLACES)
MOTES = [Point2D(float(x), float(y)) for x in (2, 9, 17) for y in (3, 10, 18)]
LOSS = PathLoss()
STEP = Twist2D(0.15, 0.0, 0.05)


def located(believed: Pose2D = TRUE, **spec: object) -> Localiser:
    return Localiser(believed, 0.1, 0.03, LocaliserSpec(**spec))  # type: ignore[arg-type]


class Listener:
    """A robot that drives a curve and hears a mote with each step."""

    def __init__(self) -> None:
        self.true = Pose2D(10.0, 6.0, 0.0)
        self.localiser = located(self.true)
        self.heard = 0

    def step(self) -> None:
        self.true = moved_along(self.true, STEP)
        self.localiser.move(STEP)
        mote = MOTES[self.heard % len(MOTES)]
        name = f"m{self.heard % len(MOTES)}"
        self.localiser.receive(RssiSample(name, mote, LOSS.mean_dbm(self.true.distance_m(mote))))
        self.heard += 1


@pytest.mark.parametrize("before", [13, 20])
def test_a_robot_that_leaves_the_arena_frame_looks_for_itself_by_what_it_hears_from_then_on(before: int) -> None:
    """Every eighth signal, once there are enough; those from before may be what has led it astray."""
    fresh, robot = Listener(), Listener()
    fresh.localiser.part("mates contradict it")
    for _ in range(before):
        robot.step()
    robot.localiser.part("mates contradict it")
    assert robot.localiser.lost == "mates contradict it"
    robot.heard = 0
    for each in (fresh, robot):
        while each.localiser.arena_fix is None:
            each.step()
            assert each.heard < 80
    assert robot.heard == fresh.heard
    assert robot.heard % 8 == 0
    pose, _ = robot.localiser.arena_fix or (IDENTITY, None)
    assert pose.distance_m(robot.true) < 1.0


def test_where_a_robot_may_be_is_asked_of_what_it_has_heard_since_it_left_its_frame() -> None:
    robot = Listener()
    assert robot.localiser.may_be_at(ELSEWHERE), "it has heard nothing"
    allowed = []
    for _ in range(14):
        robot.step()
        allowed.append(robot.localiser.may_be_at(robot.true))
    assert allowed == [False] * 11 + [True] * 3
    assert not robot.localiser.may_be_at(Pose2D(2.0, 16.0, 0.0))
    robot.localiser.part("mates contradict it")
    assert not robot.localiser.may_be_at(robot.true)
    for _ in range(12):
        robot.step()
    assert robot.localiser.may_be_at(robot.true)


def test_scans_that_did_not_fit_before_the_frame_was_found_do_not_count_after() -> None:
    localiser = located(watch=DivergenceSpec(misfits_max=3))
    lost = []
    for turn in range(5):
        if turn == 2:
            localiser.join()
        localiser.see(ROOM.points(ELSEWHERE), local_map(ROOM_MAP))
        assert not localiser.fits or localiser.lost
        lost.append(bool(localiser.lost))
    assert lost == [False, False, False, False, True]


GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 80, 60)
START = Pose2D(4.0, 1.05, 0.0)


def others_map() -> OccupancyGrid:
    """Floor, and a wall 2 m ahead on the left."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    classes[30] = OCCUPIED
    classes[31:] = -1
    grid = OccupancyGrid(GEOMETRY)
    grid.merge_patch(0, 0, classes, 5)
    return grid


def beams(at_wall: int, on_floor: int, beyond: int = 0) -> np.ndarray:
    """Ends of so many beams at the wall, short of it, and where nothing is known, sensor's frame."""
    ends_m = [2.0] * at_wall + [1.2] * on_floor + [0.0] * beyond
    points = np.array([(0.1 * n - 1.0, y_m) for n, y_m in enumerate(ends_m)])
    points[at_wall + on_floor :] = (-30.0, 0.0)
    return points


@pytest.mark.parametrize(
    ("at_wall", "on_floor", "beyond", "is_decided", "is_lost"),
    [
        (10, 0, 0, True, False),
        (6, 4, 0, True, False),  # six in ten are enough
        (5, 5, 0, True, True),
        (0, 10, 0, True, True),
        (5, 0, 5, True, False),  # the map knows half of it
        (0, 5, 5, True, True),
        (0, 4, 5, False, False),
    ],
)
def test_a_start_is_false_if_the_map_knows_the_place_and_most_of_what_is_seen_is_otherwise(
    at_wall: int, on_floor: int, beyond: int, is_decided: bool, is_lost: bool
) -> None:
    localiser, others = located(START), others_map()
    said = localiser.check_start(others.log_odds, others.geometry, beams(at_wall, on_floor, beyond))
    assert said is is_decided
    assert bool(localiser.lost) == is_lost
    assert localiser.beginnings == is_lost


def test_a_start_is_checked_from_where_the_sensor_was() -> None:
    localiser, others = located(Pose2D(START.x_m + 1.0, START.y_m, math.pi)), others_map()
    T_robot_sensor = Pose2D(1.0, 0.0, -math.pi)
    assert localiser.check_start(others.log_odds, others.geometry, beams(10, 0), T_robot_sensor)
    assert localiser.lost == ""
