"""The compiled way out against its docstring, written in plain Python."""

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest

from robrain.algorithms.navigation import right_of_way as escape
from robrain.algorithms.navigation.right_of_way import HEAD_START_S, STEP_M, Track, escape_cells, sample_path
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.2, -1.0, 0.5, 24, 18)
SPEED_M_S, KEEP_M, APART_M = 0.6, 0.4, 0.2
REACH_M = KEEP_M + APART_M


def _distance_m(cell: tuple[int, int], position: np.ndarray) -> float:
    place = GEOMETRY.center_of(*cell)
    return math.dist((place.x_m, place.y_m), position)


def _track(draw: np.random.Generator) -> Track:
    positions = sample_path(draw.uniform((-1.0, 0.5), (3.8, 4.1), (int(draw.integers(1, 4)), 2)), 100.0)
    return Track(positions, draw.choice([0.3, 0.9]), len(positions) - 1, KEEP_M, goes_first=bool(draw.random() < 0.7))


def _closes_s(cell: tuple[int, int], start: tuple[int, int], tracks: list[Track]) -> float:
    closes_s = [math.inf]
    for track in tracks:
        for k, position in enumerate(track.positions):
            if track.goes_first and _distance_m(cell, position) < REACH_M:
                closes_s.append(HEAD_START_S + k * STEP_M / track.speed_m_s)
        now = track.positions[0]
        if _distance_m(cell, now) < min(REACH_M, _distance_m(start, now)) - 1e-9:
            closes_s.append(0.0)
    return min(closes_s)


def _neighbours(free: set[tuple[int, int]], cell: tuple[int, int]) -> list[tuple[int, int]]:
    row, column = cell
    around = [(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    return [near for near in around if {near, (row, near[1]), (near[0], column)} <= free]


def _first_refuge_s(free: set[tuple[int, int]], start: tuple[int, int], tracks: list[Track]) -> float:
    """When the first cell is reached that never closes; inf for never."""
    arrives_s, heap = {start: 0.0}, [(0.0, start)]
    while heap:
        at_s, cell = heapq.heappop(heap)
        if math.isinf(_closes_s(cell, start, tracks)):
            return at_s
        for near in _neighbours(free, cell):
            near_s = at_s + math.dist(cell, near) * GEOMETRY.resolution_m / SPEED_M_S
            if near_s < arrives_s.get(near, math.inf) and near_s < _closes_s(near, start, tracks):
                arrives_s[near] = near_s
                heapq.heappush(heap, (near_s, near))
    return math.inf


@pytest.mark.parametrize("window_m", [12.0, 0.8])
def test_way_out_is_the_quickest_on_which_each_cell_is_reached_before_it_closes(
    window_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(escape, "WINDOW_M", window_m)
    within = round(window_m / GEOMETRY.resolution_m)
    draw = np.random.default_rng(3)
    lengths = []
    for _ in range(100):
        mask = draw.random(GEOMETRY.shape) < draw.choice([0.5, 0.75, 0.95])
        tracks = [_track(draw) for _ in range(int(draw.integers(1, 3)))]
        start = GEOMETRY.cell_of(*draw.choice(tracks[0].positions))
        mask[start] = True
        if min(_distance_m(start, track.positions[0]) for track in tracks) < REACH_M and not any(
            track.goes_first and _distance_m(start, track.positions[0]) < REACH_M - 0.01 for track in tracks
        ):
            continue  # the start lies exactly on the rim of what must not be approached
        free = {
            (int(row), int(column))
            for row, column in np.argwhere(mask)
            if abs(row - start[0]) <= within and abs(column - start[1]) <= within
        }
        cells = escape_cells(mask, GEOMETRY, start, SPEED_M_S, tracks, APART_M)
        expected_s = _first_refuge_s(free, start, tracks)
        if cells is None:
            assert math.isinf(expected_s)
            lengths.append(0)
            continue
        way = [(int(row), int(column)) for row, column in cells]
        assert way[0] == start
        at_s = 0.0
        for before, cell in pairwise(way):
            assert cell in _neighbours(free, before)
            at_s += math.dist(before, cell) * GEOMETRY.resolution_m / SPEED_M_S
            assert at_s < _closes_s(cell, start, tracks)
        assert math.isinf(_closes_s(way[-1], start, tracks))
        assert at_s == pytest.approx(expected_s)
        lengths.append(len(way))
    assert lengths.count(0) >= 3
    assert sum(length > 2 for length in lengths) >= 10
