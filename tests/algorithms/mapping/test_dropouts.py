"""Beams without a return: single ones say nothing, many side by side say that the way is free."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.localization.scan_match import without_dropouts
from robrain.algorithms.mapping.local_map import NO_DRIFT
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.grid_geometry import FREE
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, GEOMETRY, NOBODY, ROOM, ROOM_PLACES

BEAMS = 12


def ranges(*missed, miss_m=6.0):
    ranges_m = np.full(BEAMS, 2.0)
    ranges_m[list(missed)] = miss_m
    return ranges_m


@pytest.mark.parametrize("miss_m", [6.0, 7.5, math.inf, math.nan])
@pytest.mark.parametrize(
    ("missed", "dropped"),
    [
        ((), []),
        ((5,), [5]),
        ((3, 5), [3, 5]),
        ((4, 5, 6), [4, 5, 6]),
        ((4, 5, 6, 7), []),
        ((4, 5, 6, 7, 8), []),
        ((1, 4, 5, 6, 7), [1]),
        ((0, 11), [0, 11]),
        ((0, 1, 10, 11), []),
        (range(BEAMS), []),
    ],
)
def test_fewer_than_four_neighbouring_beams_without_a_return_say_nothing(missed, dropped, miss_m):
    heard_m = without_dropouts(ranges(*missed, miss_m=miss_m), 6.0, 4)
    silent = [beam for beam in range(BEAMS) if math.isnan(heard_m[beam])]
    assert silent == (sorted(missed) if math.isnan(miss_m) else dropped)


def test_a_lidar_that_never_misses_a_wall_is_believed_beam_by_beam():
    assert without_dropouts(ranges(3, 5, 6), 6.0, 1).tolist() == ranges(3, 5, 6).tolist()


@given(st.lists(st.sampled_from((0.5, 2.0, 6.0)), max_size=40))
def test_beams_with_a_return_stay_as_they_are(ranges_m):
    given_m = np.array(ranges_m)
    heard_m = without_dropouts(given_m, 6.0, 4)
    assert np.array_equal(heard_m[given_m < 6.0], given_m[given_m < 6.0])
    assert given_m.tolist() == ranges_m, "the scan is left as it is"


def test_a_lidar_with_dropouts_maps_no_floor_behind_walls():
    rng = np.random.default_rng(1)
    whole, holed = (OwnSubmaps(GEOMETRY, SubmapGraph("r1", GraphSpec()), SubmapSpec()) for _ in range(2))
    for own in (whole, holed):
        own.begin_submap(1, ROOM_PLACES[0], NO_DRIFT, np.diag((0.04, 0.03, 0.01)))
    for stamp_ms, place in enumerate(ROOM_PLACES, 1):
        ranges_m = ROOM.ranges_m(place)
        assert ranges_m.max() > 5.0
        whole.integrate(place, ANGLES_RAD, ranges_m, 20.0, stamp_ms, NOBODY, NO_DRIFT)
        dropped_m = np.where(rng.random(ranges_m.shape) < 0.05, 20.0, ranges_m)
        holed.integrate(place, ANGLES_RAD, dropped_m, 20.0, stamp_ms, NOBODY, NO_DRIFT)
    floor = whole.grid.classes() == FREE
    assert floor.sum() > 3000
    assert not (holed.grid.classes() == FREE)[~whole.grid.known()].any()
    assert (holed.grid.classes() == FREE)[floor].mean() > 0.99
