"""The fit of a field to readings around."""

import math

import numpy as np
import pytest

from robrain.algorithms.navigation.source_seeking import MOTES_MAX, SAMPLES_MAX, FieldSamples
from robrain.protocol.model.geometry import Point2D


def paraboloid(x_m, y_m):
    return 30.0 - 0.5 * ((x_m - 1.0) ** 2 + (y_m + 2.0) ** 2)


def plume(x_m, y_m):
    """A Gaussian around (3, 1) m with a standard deviation of 2.5 m."""
    return 20.0 + 12.0 * math.exp(-0.5 * ((x_m - 3.0) ** 2 + (y_m - 1.0) ** 2) / 2.5**2)


def sampled(field, places, *, noise=None):
    samples = FieldSamples()
    for index, (x_m, y_m) in enumerate(places):
        samples.add(Point2D(x_m, y_m), field(x_m, y_m) + (0.0 if noise is None else noise[index]), float(index))
    return samples


CIRCLE = [(math.cos(0.5 * step), math.sin(0.5 * step)) for step in range(13)]


def test_a_paraboloid_is_found_but_for_the_ridge():
    fit = sampled(paraboloid, [*CIRCLE, *((2 * x, 2 * y) for x, y in CIRCLE)]).fit(Point2D(0.0, 0.0), 26.0, 2.5)
    assert fit.summit.x_m == pytest.approx(1.0, abs=0.05)
    assert fit.summit.y_m == pytest.approx(-2.0, abs=0.05)
    assert fit.summit_value == pytest.approx(30.0, abs=0.05)
    assert fit.slope == pytest.approx((1.0, -2.0), abs=0.05)
    assert not fit.is_flat


@pytest.mark.parametrize("seed", range(5))
def test_the_source_within_the_circle_is_found_in_noise(seed):
    noise = 0.2 * np.random.default_rng(seed).standard_normal(39)
    ring = [(3.3 + 0.03 * step * math.cos(step), 0.8 + 0.03 * step * math.sin(step)) for step in range(39)]
    fit = sampled(plume, ring, noise=noise.tolist()).fit(Point2D(3.3, 0.8), 39.0, 1.2)
    assert math.hypot(fit.summit.x_m - 3.0, fit.summit.y_m - 1.0) < 4.0 * fit.summit_sd_m
    assert fit.summit_sd_m < 0.3


def test_readings_at_one_distance_do_not_tell_where_the_summit_is():
    noise = (0.1 * np.random.default_rng(1).standard_normal(13)).tolist()
    fit = sampled(plume, CIRCLE, noise=noise).fit(Point2D(0.0, 0.0), 13.0, 2.5)
    assert fit.summit is None
    assert fit.summit_sd_m == math.inf
    assert not fit.is_flat


def test_a_flat_field_in_noise_has_no_slope():
    flat = 0
    for seed in range(20):
        noise = np.random.default_rng(seed).standard_normal(13).tolist()
        fit = sampled(lambda _x, _y: 20.0, CIRCLE, noise=noise).fit(Point2D(0.0, 0.0), 13.0, 2.5)
        flat += fit.is_flat and fit.summit is None
    assert flat >= 15


def test_of_a_mote_the_latest_reading_counts_and_memory_is_bounded():
    samples = FieldSamples()
    for number in range(2 * SAMPLES_MAX):
        samples.add(Point2D(0.0, 0.0), 1.0, float(number))
    assert len(samples) == SAMPLES_MAX
    for time_s, value in ((10.0, 5.0), (9.0, 7.0), (11.0, 6.0), (10.5, 8.0)):
        samples.receive("m1", Point2D(1.0, 0.0), value, time_s)
    assert samples._of_motes["m1"].value == 6.0
    for number in range(2 * MOTES_MAX):
        samples.receive(f"m{number}", Point2D(1.0, 0.0), 1.0, 1.0)
    assert len(samples) == SAMPLES_MAX + MOTES_MAX
