"""The radio between robots: reach, symmetry, and randomness that more robots leave alone."""

import numpy as np
import pytest

from robrain.sim.motes.radio import RadioModel, RobotAir

PLAIN = RadioModel(shadowing_db=0.0)


def places(*xs_m):
    return np.array(xs_m, float), np.zeros(len(xs_m))


def air(radio=PLAIN, seed=1):
    return RobotAir(radio, np.random.SeedSequence(seed))


def strengths_dbm(one, sender, spots, packets=400):
    """Mean strength at each robot that heard anything."""
    heard = {}
    for tick in range(packets):
        for robot, rssi_dbm in one.receivers_of(sender, *spots, tick):
            heard.setdefault(robot, []).append(rssi_dbm)
    return {robot: (len(each), float(np.mean(each))) for robot, each in heard.items()}


def test_a_robot_hears_others_by_their_distance_and_never_itself():
    heard = strengths_dbm(air(), 0, places(0.0, 2.0, 5.0, 60.0), packets=5)
    assert heard == {
        1: (5, pytest.approx(PLAIN.mean_rssi_dbm_of(np.array([2.0]))[0])),
        2: (5, pytest.approx(PLAIN.mean_rssi_dbm_of(np.array([5.0]))[0])),
    }


def test_both_directions_have_the_same_shadow():
    one = air(RadioModel(shadowing_db=6.0, static_share=1.0))
    spots = places(0.0, 3.0)
    there, back = strengths_dbm(one, 0, spots, 3)[1], strengths_dbm(one, 1, spots, 3)[0]
    assert there == back
    assert there[1] != pytest.approx(PLAIN.mean_rssi_dbm_of(np.array([3.0]))[0], abs=1e-6)


def test_at_the_edge_of_reach_half_of_the_packets_arrive_and_the_rest_is_counted():
    one = air()
    (heard,) = strengths_dbm(one, 0, places(0.0, 10.0), packets=1000).values()
    assert heard[0] == pytest.approx(500, abs=60)
    counters = one.counters
    assert (counters.sent, counters.received) == (1000, heard[0])
    assert counters.crc_errors + counters.lost == 1000 - heard[0]


def test_another_robot_changes_nothing_between_the_others():
    radio = RadioModel()
    few, many = air(radio), air(radio)
    for tick in range(50):
        two, three = places(0.0, 8.0), places(0.0, 8.0, 4.0)
        assert few.receivers_of(0, *two, tick) == [each for each in many.receivers_of(0, *three, tick) if each[0] == 1]
