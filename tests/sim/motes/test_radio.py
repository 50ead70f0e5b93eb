import numpy as np
import pytest

from robrain.sim.motes.radio import FadingLinks, RadioCounters, RadioModel, ShadowField

FIELDS = 2000


def fields_at(xs_m, correlation_m=3.0):
    """Values of many fields at places on a line: (fields, places)."""
    ys_m = np.zeros(len(xs_m))
    rngs = np.random.default_rng(1).spawn(FIELDS)
    return np.array([ShadowField(4.0, correlation_m, rng).at(np.array(xs_m), ys_m) for rng in rngs])


def test_shadowing_has_its_deviation_at_every_place():
    values = fields_at([0.0, 1.0, 17.0])
    assert values.mean() == pytest.approx(0.0, abs=0.2)
    assert values.std(axis=0) == pytest.approx([4.0] * 3, rel=0.05)


def test_shadowing_s_correlation_falls_exponentially_with_the_distance():
    distances_m = [0.0, 0.5, 1.5, 3.0, 6.0]
    values = fields_at(distances_m)
    correlations = [np.corrcoef(values[:, 0], values[:, column])[0, 1] for column in range(len(distances_m))]
    assert correlations == pytest.approx([np.exp(-each / 3.0) for each in distances_m], abs=0.05)


def test_half_of_the_packets_arrive_at_the_sensitivity_and_a_few_decibels_make_all_or_none():
    model = RadioModel()
    probabilities = [model.arrival_probability(-90.0 + above_db) for above_db in (-4.0, -1.0, 0.0, 1.0, 3.0)]
    assert probabilities == sorted(probabilities)
    assert probabilities[0] < 1e-6
    assert probabilities[2] == pytest.approx(0.5)
    assert probabilities[4] > 0.99


def test_what_does_not_arrive_is_counted_as_broken_or_as_lost():
    model = RadioModel(shadowing_db=0.0)
    counters = RadioCounters()
    links = FadingLinks(model, np.random.SeedSequence(1), counters)
    for strength_dbm in (-60.0, -91.0, -100.0):
        for _ in range(1000):
            links.receive_dbm((1, 2), strength_dbm)
    assert counters.received == pytest.approx(1000 + 1000 * model.arrival_probability(-91.0), abs=60)
    assert counters.lost == 1000
    assert counters.received + counters.crc_errors + counters.lost == 3000
