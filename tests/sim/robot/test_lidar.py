"""The lidar's imperfections: beams that drop out, and ranges that are anything."""

import numpy as np
import pytest

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.robot.lidar import Lidar, LidarSpec

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 80, 80)
WALLS = np.ones(GEOMETRY.shape, np.bool_)
WALLS[1:-1, 1:-1] = False
HERE = Pose2D(4.0, 4.0, 0.0)
NO_ROBOTS = np.empty((0, 3))
TURNS = 20


def turns_mm(seed=1, **spec):
    """Ranges (TURNS, rays) in a room of 8 × 8 m, from its middle; 0 is no return."""
    lidar = Lidar(LidarSpec(**spec), "r1", WALLS, GEOMETRY, np.random.default_rng(seed))
    return np.array([lidar.scan(HERE, NO_ROBOTS).ranges_mm for _ in range(TURNS)])


def test_share_of_beams_that_drops_out_returns_nothing_and_the_others_stay_as_they_were():
    whole = turns_mm(noise_m=0.0)
    assert (whole > 0).all()
    spoiled = turns_mm(noise_m=0.0, dropout=0.2)
    assert np.count_nonzero(spoiled == 0) / spoiled.size == pytest.approx(0.2, abs=0.02)
    assert (spoiled[spoiled > 0] == whole[spoiled > 0]).all()


def test_share_of_beams_that_are_outliers_has_ranges_over_all_of_its_reach():
    whole = turns_mm(noise_m=0.0)
    spoiled = turns_mm(noise_m=0.0, outlier=0.1)
    outliers_mm = spoiled[spoiled != whole]
    assert len(outliers_mm) / spoiled.size == pytest.approx(0.1, abs=0.015)
    assert outliers_mm.min() >= 50
    assert outliers_mm.max() <= 6000
    counts, _ = np.histogram(outliers_mm, bins=6, range=(0, 6000))
    assert (counts > 0.1 * len(outliers_mm)).all()


def test_beams_drop_out_last_so_that_with_all_of_them_nothing_is_left():
    assert not turns_mm(dropout=1.0, outlier=1.0).any()
