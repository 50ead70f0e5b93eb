"""Where walls may lie on a map: any pose is found, and branch and bound finds what trying all places does."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from robrain.algorithms.slam import map_overlap
from robrain.algorithms.slam.map_overlap import (
    BEST,
    LEVELS,
    NEARLY,
    REACH_CELLS,
    SCORE_MIN,
    UNKNOWN,
    YAWS,
    search_places,
)
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES

ROOM_MAP = ROOM.mapped(*ROOM_PLACES).log_odds
STEP = 1 << LEVELS
MARGIN = 60


def off(pose, other):
    return pose.distance_m(other), abs(math.remainder(pose.yaw_rad - other.yaw_rad, math.tau))


@settings(deadline=None, max_examples=30)
@given(st.sampled_from([*ROOM_PLACES, Pose2D(0.45, 0.45, 0.0), Pose2D(7.5, 5.5, 0.0)]), st.floats(-math.pi, math.pi))
def test_a_scan_is_found_on_the_map_in_whatever_direction_it_was_made(place, yaw_rad):
    true = Pose2D(place.x_m, place.y_m, yaw_rad)
    (_, found), *_ = search_places(ROOM_MAP, GEOMETRY, ROOM.points(true), 4)
    off_m, off_rad = off(found, true)
    assert off_m < 0.2
    assert off_rad < math.tau / YAWS


def test_memory_for_places_is_bounded():
    """One point beside a wall lies on it in all directions, from nearly everywhere."""
    log_odds = np.full((300, 300), -50, np.int8)
    log_odds[::8, ::8] = 50
    found = search_places(log_odds, GridGeometry(0.1, 0.0, 0.0, 300, 300), np.array([(0.4, 0.0)]), 1_000_000)
    assert len(found) == map_overlap.NODES_MAX


def all_scores(log_odds, points):
    """Nearness of the points to walls at each free cell, by yaw, row and column; −1 where there is no floor."""
    height, width = log_odds.shape
    free = np.ones((height + 2 * MARGIN, width + 2 * MARGIN), np.bool_)
    free[MARGIN:-MARGIN, MARGIN:-MARGIN] = log_odds <= 0
    away = distance_transform_edt(free) if not free.all() else np.full(free.shape, math.inf)
    nearness = np.floor(BEST * (1.0 - np.minimum(away, REACH_CELLS).astype(np.float32) / REACH_CELLS))
    known = np.zeros(free.shape, np.bool_)
    known[MARGIN:-MARGIN, MARGIN:-MARGIN] = log_odds != 0
    nearness = np.where(known, nearness, np.maximum(nearness, UNKNOWN))
    floor = np.argwhere(log_odds < 0)
    scores = np.full((YAWS, height, width), -1.0)
    for k in range(YAWS):
        cos, sin = math.cos(k * math.tau / YAWS), math.sin(k * math.tau / YAWS)
        right = np.floor(0.5 + cos * points[:, 0] - sin * points[:, 1]).astype(int)
        up = np.floor(0.5 + sin * points[:, 0] + cos * points[:, 1]).astype(int)
        rows, columns = floor[:, :1] + up + MARGIN, floor[:, 1:] + right + MARGIN
        scores[k, floor[:, 0], floor[:, 1]] = nearness[rows, columns].mean(axis=1)
    return scores


def best_of_blocks(scores):
    """The best of each yaw and coarse cell."""
    yaws, height, width = scores.shape
    up, right = -(-height // STEP), -(-width // STEP)
    padded = np.full((yaws, up * STEP, right * STEP), -1.0)
    padded[:, :height, :width] = scores
    return padded.reshape(yaws, up, STEP, right, STEP).max(axis=(2, 4))


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(st.integers(0, 100_000), st.integers(3, 27), st.integers(3, 27), st.sampled_from([0.03, 0.1, 0.3]))
def test_branch_and_bound_finds_what_trying_all_places_finds(seed, height, width, share):
    rng = np.random.default_rng(seed)
    log_odds = rng.choice(np.array((50, -50, 0), np.int8), (height, width), p=(share, 0.6, 0.4 - share))
    log_odds[[0, 0, -1, -1], [0, -1, 0, -1]] = -50  # so that the map is as large as it is
    walls = np.argwhere(log_odds > 0)
    if not len(walls):
        return
    seen = walls[rng.permutation(len(walls))[: int(rng.integers(1, 30))]]
    turn_rad, at = rng.uniform(0.0, math.tau), rng.uniform((0.0, 0.0), (height, width))
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    offsets = (seen - at + rng.normal(0.0, 0.5, seen.shape))[:, ::-1]
    points = offsets @ np.array([[cos, -sin], [sin, cos]])
    found = search_places(log_odds, GridGeometry(0.1, 0.0, 0.0, width, height), 0.1 * points, 1_000_000)

    best = best_of_blocks(all_scores(log_odds, points))
    most = best.max()
    if most < SCORE_MIN * BEST:
        assert found == []
        return
    assert found[0][0] * BEST == pytest.approx(most)
    told = {}
    for score, pose in found:
        k = round(pose.yaw_rad * YAWS / math.tau) % YAWS
        row, column = int(pose.y_m / 0.1), int(pose.x_m / 0.1)
        assert log_odds[row, column] < 0
        told[k, row // STEP, column // STEP] = score * BEST
    assert len(told) == len(found), "one place for each coarse cell and yaw"
    for block, score in told.items():
        assert score == pytest.approx(best[block])
    least = max(SCORE_MIN * BEST, NEARLY * most) + 1e-3
    assert {block for block, score in told.items() if score > least} == {
        tuple(block) for block in np.argwhere(best > least).tolist()
    }
