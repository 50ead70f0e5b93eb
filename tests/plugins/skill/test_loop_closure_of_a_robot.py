"""A robot whose wheels are wrong drives around a block; the plugins map, close the loop, and put the map right."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.mapping.map_accuracy import measure_map_accuracy
from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.algorithms.slam.map_patch import merge_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.can.frames import codec
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.model.geometry import Pose2D, Twist2D
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, LidarFloor

pytestmark = pytest.mark.slow

BASE = OmniBase()
GRID = {"resolution_m": 0.1, "origin_x_m": -2.0, "origin_y_m": -2.0, "width_m": 16.0, "height_m": 12.0}
BLOCK = LidarFloor(
    (0, 0, 12, 0.2),
    (0, 0, 0.2, 8),
    (0, 7.8, 12, 8),
    (11.8, 0, 12, 8),
    (3, 3, 9, 5),
    (5.5, 0.2, 6, 0.7),
    (0.2, 5, 0.8, 5.5),
)
RANGE_M = 5.0
START = Pose2D(1.5, 1.5, 0.0)
ROUND = [(9.0, 0.0), (0.0, math.pi / 2), (5.0, 0.0), (0.0, math.pi / 2)] * 2
"""Once around: way ahead, and turn."""
STEP_M, STEP_RAD = 0.012, 0.04
CURVING = (0.0, 0.0, 0.003)
"""Shares by which the wheels count too much: after a round it is 0.8 m off, and 5° turned."""
ERRORS = {"scale": 0.004, "curve_rad_per_m": 0.004, "turn": 0.004}


class Driver:
    """Drives a robot around the block, and says what its wheels count and its lidar sees."""

    def __init__(self, stage):
        self.one = stage()
        self.patches = self.one.inbox(ROBOT_MAP)
        localisation = {"x_m": START.x_m, "y_m": START.y_m, "scan_matching": False, "errors": ERRORS}
        self.host = self.one.host("mapper", "localisation", mapper=GRID, localisation=localisation)
        self.localisation = self.host.manager.get("localisation").plugin
        self.true = START
        self.errors_m = []
        self.sigmas_m = []
        self._bus = self.one.bus()
        self._counts = [0.0, 0.0, 0.0]
        self._tick = 0

    @property
    def view(self):
        return self.host.manager.get("mapper").plugin.view()

    @property
    def map_accuracy(self):
        return measure_map_accuracy(self.view.classes, self.view.geometry, BLOCK.solid, BLOCK.FINE)

    @property
    def says_how_far_off_it_may_be(self):
        sigmas_m = np.array(self.sigmas_m)
        return np.all(np.array(self.errors_m) < 3.0 * sigmas_m) and sigmas_m.max() < 2.0

    def drive_around(self):
        for path_m, turn_rad in ROUND:
            steps = max(round(path_m / STEP_M), round(turn_rad / STEP_RAD))
            for _ in range(steps):
                self._step(Twist2D(path_m / steps, 0.0, turn_rad / steps))

    def stand(self, seconds):
        for _ in range(round(50 * seconds)):
            self._step(Twist2D())

    def _step(self, by):
        self.true = moved_along(self.true, by)
        for wheel, turn_rad in enumerate(BASE.wheel_speeds_rad_s(by)):
            self._counts[wheel] += turn_rad * (1.0 + CURVING[wheel]) / BASE.rad_per_tick
        self._tick += 1
        ticks = {f"wheel_{wheel}_ticks": round(count) % 65536 for wheel, count in enumerate(self._counts, 1)}
        self._bus.send(codec("WheelEncoders").pack(self._tick % 256, **ticks))
        if self._tick % 8 == 0:
            self._scan()
        self.one.run(0.02)
        self.errors_m.append(self.localisation.pose().distance_m(self.true))
        self.sigmas_m.append(self.localisation.health().sigma_m)

    def _scan(self):
        ranges_m = BLOCK.ranges_m(self.true, range_max_m=RANGE_M)
        scan = Scan(
            robot="r1",
            stamp_ns=self.one.clock.now_ns(),
            angle_min_rad=float(ANGLES_RAD[0]),
            angle_increment_rad=float(ANGLES_RAD[1] - ANGLES_RAD[0]),
            range_max_m=RANGE_M,
            ranges_mm=[round(1000 * range_m) if range_m < RANGE_M else 0 for range_m in ranges_m.tolist()],
        )
        self.one.publisher(ARENA_SCAN, robot="r1").put(scan)


def test_when_the_loop_is_closed_the_map_is_put_right_and_the_team_and_the_robot_are_told(stage):
    driver = Driver(stage)
    driver.drive_around()
    driver.drive_around()
    assert driver.says_how_far_off_it_may_be
    driver.stand(3.0)
    team = SubmapAtlas(driver.view.geometry)
    moved = 0
    for received in driver.patches.drain():
        merge_message(team, received.message)
        moved += len(received.message.parts)
    assert moved > 5
    assert np.array_equal(team.grid.classes(), driver.view.classes)
    assert driver.map_accuracy.share_off < 0.01
    assert driver.map_accuracy.occupied_cells > 400
    finished = [submap for submap in team.submaps.values() if submap.surfaces is not None]
    assert len(finished) == len(team.submaps) - 1
    assert all(len(submap.surfaces) > 20 for submap in finished)
