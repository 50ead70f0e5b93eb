import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.maps.floor_plan import FloorPlan, PlacementError
from robrain.sim.maps.placement import scatter_points, scatter_poses, spawn_poses


def _rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def _building_in_a_field() -> FloorPlan:
    """A house of 6.5 × 6.5 m in a field of 8 × 8 m that is white too."""
    occupied = np.zeros((80, 80), dtype=bool)
    occupied[7:73, 7:73] = True
    occupied[8:72, 8:72] = False
    return FloorPlan(occupied, 0.1, 0.0, 0.0, "house")


def _two_rooms() -> FloorPlan:
    occupied = np.ones((40, 80), dtype=bool)
    occupied[1:-1, 1:30] = False
    occupied[1:-1, 31:-1] = False
    return FloorPlan(occupied, 0.1, 0.0, 0.0, "two rooms")


def _check_group(plan: FloorPlan, poses: list[Pose2D], radius_m: float, spacing_m: float) -> None:
    for pose in poses:
        assert plan.clearance_m[plan.geometry.cell_of(pose.x_m, pose.y_m)] >= radius_m + 0.05
        assert -math.pi < pose.yaw_rad <= math.pi
    for one, other in itertools.combinations(poses, 2):
        assert one.distance_m(other) >= spacing_m - 1e-6


def test_team_starts_close_together_in_the_largest_room() -> None:
    plan = _two_rooms()
    for seed in range(10):
        poses = spawn_poses(plan, 6, 0.2, near=None, rng=_rng(seed), spacing_m=0.5)
        _check_group(plan, poses, 0.2, 0.5)
        assert all(pose.x_m > 3.1 for pose in poses)
        assert max(one.distance_m(other) for one, other in itertools.combinations(poses, 2)) < 2.0


def test_team_gathers_about_the_given_point() -> None:
    poses = spawn_poses(_two_rooms(), 4, 0.2, near=Point2D(0.0, 0.0), rng=_rng(), spacing_m=0.5)
    assert poses[0].distance_m(Point2D(0.35, 0.35)) < 0.15
    assert all(pose.x_m < 3.0 for pose in poses)


def test_team_starts_in_the_largest_region() -> None:
    for seed in range(5):
        for pose in spawn_poses(_building_in_a_field(), 4, 0.2, near=None, rng=_rng(seed), spacing_m=0.5):
            assert 0.8 < pose.x_m < 7.2
            assert 0.8 < pose.y_m < 7.2


def test_too_many_robots_are_told_how_many_fit() -> None:
    with pytest.raises(PlacementError, match=r"100 robots .* asked for .* \d+ fit") as caught:
        spawn_poses(_two_rooms(), 100, 0.2, near=None, rng=_rng(), spacing_m=1.0)
    fit = int(str(caught.value).split()[-2])
    assert 10 <= fit <= 25
    assert len(spawn_poses(_two_rooms(), fit, 0.2, near=None, rng=_rng(), spacing_m=0.9)) == fit


@settings(max_examples=50)
@given(hnp.arrays(np.bool_, (15, 15)), st.integers(0, 12), st.floats(0, 4), st.integers(0, 9))
def test_scattered_points_are_distinct_free_cells_of_the_region(
    occupied: np.ndarray, count: int, spacing_m: float, seed: int
) -> None:
    plan = FloorPlan(occupied, 0.5, 0.0, 0.0, "random")
    region = np.zeros_like(occupied)
    region[:, 4:11] = True
    room = int(np.count_nonzero(region & ~occupied & (plan.clearance_m >= 0.3)))

    def scatter() -> list[Point2D]:
        return scatter_points(plan, count, region, rng=_rng(seed), min_clearance_m=0.3, spacing_m=spacing_m)

    if room < count:
        with pytest.raises(PlacementError, match=f"{room} fit"):
            scatter()
        return
    cells = [plan.geometry.cell_of(point.x_m, point.y_m) for point in scatter()]
    assert len(set(cells)) == count
    assert all(region[cell] and plan.clearance_m[cell] >= 0.3 for cell in cells)


def test_a_scattered_team_starts_far_from_each_other_in_the_largest_region() -> None:
    for seed in range(8):
        poses = scatter_poses(_two_rooms(), 6, 0.2, rng=_rng(seed), spacing_m=0.5)
        _check_group(_two_rooms(), poses, 0.2, 0.5)
        assert all(pose.x_m > 3.1 for pose in poses)
        assert min(one.distance_m(other) for one, other in itertools.combinations(poses, 2)) > 0.8
        together = spawn_poses(_two_rooms(), 6, 0.2, near=None, rng=_rng(seed), spacing_m=0.5)
        widest = [max(a.distance_m(b) for a, b in itertools.combinations(each, 2)) for each in (poses, together)]
        assert widest[0] > 1.5 * widest[1]


@pytest.mark.parametrize(("count", "radius_m"), [(100, 0.2), (2, 3.0), (10_000, 0.2)])
def test_scattered_robots_that_do_not_fit_are_told(count: int, radius_m: float) -> None:
    with pytest.raises(PlacementError, match=f"{count} "):
        scatter_poses(_two_rooms(), count, radius_m, rng=_rng(), spacing_m=1.0)


@pytest.mark.parametrize("near", [Point2D(-0.1, 1.0), Point2D(1.0, 99.0), Point2D(1e300, 1.0)])
def test_a_start_off_the_map_is_refused(near: Point2D) -> None:
    with pytest.raises(PlacementError, match=r"expected a start on the map, x from 0 to .*got"):
        spawn_poses(_two_rooms(), 2, 0.2, near=near, rng=_rng(), spacing_m=0.5)
