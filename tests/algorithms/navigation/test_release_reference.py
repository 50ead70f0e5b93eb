"""The compiled right of way against its docstring, written in plain Python."""

import math
from itertools import groupby

import numpy as np
import pytest

from robrain.algorithms.navigation.right_of_way import STEP_M, Margins, Release, Track, release, sample_path

MARGINS = Margins()
DODGE_M = 0.02
EITHER_WAY_S = 0.5


def _line(draw: np.random.Generator) -> np.ndarray:
    return sample_path(draw.uniform(0.0, 5.0, (int(draw.integers(1, 4)), 2)), 100.0)


def _track(draw: np.random.Generator) -> Track:
    positions = _line(draw)
    last = len(positions) - 1
    held_at = last if draw.random() < 0.6 else int(draw.integers(0, last + 1))
    return Track(positions, draw.choice([0.2, 0.6, 1.1]), held_at, 0.4, goes_first=bool(draw.random() < 0.6))


def _plain_release(own: np.ndarray, speed_m_s: float, tracks: list[Track], margins: Margins) -> Release:
    step_s = STEP_M / speed_m_s
    contested_by, late, meets = [-1] * len(own), [False] * len(own), [False] * len(own)
    for mate, track in enumerate(tracks):
        if not track.goes_first:
            continue
        last = len(track.positions) - 1
        for k, place in enumerate(own):
            for j, other in enumerate(track.positions):
                if math.dist(place, other) >= track.keep_m + margins.contest_m:
                    continue
                contested_by[k] = mate if contested_by[k] < 0 else contested_by[k]
                own_s, mate_s = k * step_s, j * STEP_M / track.speed_m_s
                stays = track.held_at < last or j == last
                waits_there = k == len(own) - 1 and mate_s >= own_s
                for told, slack_s in ((late, margins.slack_s), (meets, 0.5 * step_s)):
                    told[k] |= waits_there or (mate_s <= own_s + slack_s and (stays or mate_s >= own_s - slack_s))
    end, by, must_leave = len(own), -1, False
    for is_contested, group in groupby(range(len(own)), key=lambda k: contested_by[k] >= 0):
        stretch = list(group)
        begins_here = stretch[0] == 0
        if is_contested and any((meets if begins_here else late)[k] for k in stretch):
            end, by, must_leave = max(stretch[0], 1), contested_by[stretch[0]], begins_here
            break
    for mate, track in enumerate(tracks):
        now_m = math.dist(track.positions[0], own[0])
        for k in range(1, end):
            own_s = k * step_s
            if own_s > margins.guard_s:
                break
            step_of_mate_s = STEP_M / track.speed_m_s
            low = min(track.held_at, int(max(0.0, own_s - EITHER_WAY_S) / step_of_mate_s))
            high = min(track.held_at, int((own_s + EITHER_WAY_S) / step_of_mate_s) + 1)
            nearest_m = min(math.dist(track.positions[j], own[k]) for j in range(low, high + 1))
            if nearest_m < track.keep_m + margins.guard_m and nearest_m < now_m - DODGE_M:
                end, by = max(1, k - 1), mate
                break
    return Release(end, is_whole=end == len(own), must_leave=must_leave, by=by)


@pytest.mark.slow
def test_release_is_what_its_rules_say_for_any_ways() -> None:
    draw = np.random.default_rng(12)
    seen = []
    for _ in range(400):
        own, tracks = _line(draw), [_track(draw) for _ in range(int(draw.integers(0, 4)))]
        speed_m_s = draw.choice([0.3, 0.6])
        found = release(own, speed_m_s, tracks, MARGINS)
        assert found == _plain_release(own, speed_m_s, tracks, MARGINS)
        seen.append(found)
    assert {found.by for found in seen} == {-1, 0, 1, 2}
    assert {found.must_leave for found in seen} == {False, True}
    assert 50 < sum(found.is_whole for found in seen) < 350


def test_mate_that_hardly_moves_is_foreseen_where_it_is() -> None:
    own = sample_path(np.array([(0.0, 0.0), (4.0, 0.0)]), 100.0)
    mate = sample_path(np.array([(1.2, 0.0), (1.2, 4.0)]), 100.0)
    found = release(own, 0.6, [Track(mate, 0.0, 0, 0.4, goes_first=False)], MARGINS)
    assert found.positions * STEP_M == pytest.approx(1.2 - 0.4 - MARGINS.guard_m, abs=0.21)
