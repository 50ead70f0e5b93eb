import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.local_map import NO_DRIFT, Drift
from robrain.algorithms.slam.submap import PARTS
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, GEOMETRY, NOBODY, RANGE_M, ROOM

PRIOR = np.diag((0.04, 0.03, 0.01))
START = Pose2D(1.0, 3.1, 0.3)


def mapper(**spec: float) -> OwnSubmaps:
    return OwnSubmaps(GEOMETRY, SubmapGraph("r1", GraphSpec()), SubmapSpec(**spec))


def begun(number: int = 5, **spec: float) -> OwnSubmaps:
    own = mapper(**spec)
    own.begin_submap(number, START, NO_DRIFT, PRIOR)
    return own


def scan(own: OwnSubmaps, sensor: Pose2D, *, drift: Drift = NO_DRIFT, ignore: np.ndarray = NOBODY) -> None:
    own.integrate(sensor, ANGLES_RAD, ROOM.ranges_m(sensor), RANGE_M, 7, ignore, drift)


def test_the_first_submap_is_as_unsure_as_the_robot_and_the_next_one_by_what_it_drifted_more() -> None:
    own = mapper()
    own.begin_submap(5, START, (0.01, 0.001), PRIOR)
    node = own.graph.current
    assert node is not None
    assert node.covariance == pytest.approx(PRIOR)
    own.begin_submap(6, START, (0.05, 0.003), PRIOR)
    node = own.graph.current
    assert node is not None
    assert np.diag(node.covariance) == pytest.approx((0.08, 0.07, 0.012), abs=2e-6)
    local = own.local_map()
    assert local is not None
    assert local.drift == (0.05, 0.003)
    own.begin_submap(7, START, (0.05, 0.001), PRIOR)  # surer than before: it has come back to walls that it saw early
    node = own.graph.current
    assert node is not None
    assert np.diag(node.covariance) == pytest.approx((0.08, 0.07, 0.012), abs=2e-6)


@pytest.mark.parametrize(("steps", "path_m"), [([(1.0, 0.0), (1.0, 0.0)], 2.0), ([(0.3, 0.4), (0.0, -0.4)], 0.9)])
def test_a_submap_ends_after_its_way(steps: list[tuple[float, float]], path_m: float) -> None:
    for longer_m, is_over in ((-0.01, True), (0.01, False)):
        own = begun(path_m=path_m + longer_m)
        at = START
        scan(own, at)
        for dx_m, dy_m in steps:
            assert not own.is_over()
            at = Pose2D(at.x_m + dx_m, at.y_m + dy_m, at.yaw_rad)
            scan(own, at)
        assert own.is_over() == is_over
        own.begin_submap(6, at, NO_DRIFT, PRIOR)
        assert not own.is_over(), "the next one begins with no way"


def test_a_robot_that_was_lost_goes_by_nothing_that_it_saw_before() -> None:
    own = begun()
    scan(own, START)
    assert own.grid.known_count > 1000
    own.begin_trajectory(1)
    assert own.trajectory == 1
    assert own.grid.known_count == 0
    assert own.number is None
    assert own.is_over()
    assert own.local_map() is None
    assert own.pop_patch() is None
    own.begin_submap(6, START, NO_DRIFT, PRIOR)
    local = own.local_map()
    assert local is not None
    assert (local.oldest, local.trajectory) == (6, 1)
    assert own.graph.own[5].trajectory != own.graph.own[6].trajectory


def test_the_own_map_is_wider_than_the_teams_by_a_margin_on_each_side() -> None:
    found = mapper(margin_m=0.25).grid.geometry
    assert (found.origin_x_m, found.origin_y_m) == pytest.approx((GEOMETRY.origin_x_m - 0.3, GEOMETRY.origin_y_m - 0.3))
    assert (found.width, found.height) == (GEOMETRY.width + 6, GEOMETRY.height + 6)


@settings(deadline=None, max_examples=30)
@given(bearing_rad=st.floats(-3.14, 3.14), range_m=st.floats(0.5, 2.0))
def test_what_is_told_of_a_wall_is_where_the_beam_ended(bearing_rad: float, range_m: float) -> None:
    own = begun()
    own.integrate(Pose2D(4.0, 4.0, 0.0), np.array([bearing_rad]), np.array([range_m]), 6.0, 7, NOBODY, NO_DRIFT)
    (surface,) = own.surfaces()
    x = surface["column"] + 0.5 + surface["right"] / PARTS
    y = surface["row"] + 0.5 + surface["up"] / PARTS
    assert x == pytest.approx(40.0 + 10.0 * range_m * math.cos(bearing_rad), abs=0.01)
    assert y == pytest.approx(40.0 + 10.0 * range_m * math.sin(bearing_rad), abs=0.01)
    view_rad = surface["view"] * math.tau / 256
    assert math.remainder(view_rad - bearing_rad, math.tau) == pytest.approx(0.0, abs=0.6 * math.tau / 256)
