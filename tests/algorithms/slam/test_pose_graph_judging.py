"""What an edge is judged by (`gate`), and what counts for the covariances (`sure`)."""

import numpy as np
import pytest

from robrain.algorithms.slam.pose_graph import ITERATIONS_MAX, SCALING, Edge, solve
from robrain.protocol.model.geometry import Pose2D

ORIGIN = Pose2D(0.0, 0.0, 0.0)
EVEN = np.diag((100.0, 100.0, 400.0))
LOOSE = np.diag((1.0, 1.0, 4.0))


def edge(at_m, information=EVEN, *, may_be_false=False, sure=None, gate=None):
    """The held node 1 says that the free node 0 is there."""
    return Edge(1, Pose2D(at_m, 0.0, 0.0), 0, ORIGIN, information, may_be_false, sure, gate)


def solved(*edges, begun=ORIGIN):
    solution = solve([begun], [ORIGIN], list(edges))
    assert solution is not None
    return solution


def weight_of(expected):
    """Dynamic covariance scaling: s² with s = 2Φ / (Φ + χ²), at most 1."""
    return min(1.0, 2.0 * SCALING / (SCALING + expected)) ** 2


def test_an_edge_counts_in_full_as_long_as_its_residual_is_as_large_as_expected():
    residual_m = 0.99 * (2 * SCALING / 100.0) ** 0.5  # half of it is left at the middle
    solution = solved(edge(0.0), edge(residual_m, may_be_false=True))
    assert solution.poses[0].x_m == pytest.approx(residual_m / 2.0, rel=1e-3)


def test_the_weight_of_a_doubtful_edge_is_that_of_dynamic_covariance_scaling():
    """Where the two pull alike, the weights are those of the residuals that are left."""
    apart_m = 1.0
    solution = solved(edge(0.0), edge(apart_m, may_be_false=True))
    x_m = solution.poses[0].x_m
    weight = weight_of(100.0 * (apart_m - x_m) ** 2)
    assert weight < 0.2
    assert x_m == pytest.approx(weight * (apart_m - x_m), rel=1e-3)
    assert solution.squared_residuals == pytest.approx([100.0 * x_m**2, 100.0 * (apart_m - x_m) ** 2])
    assert solution.covariances[0][0, 0] == pytest.approx(1.0 / (100.0 * (1.0 + weight)), rel=1e-3)


def test_an_edge_is_judged_by_what_its_residual_may_be_and_weighs_as_it_is_known():
    """A robot that has gone far without closing a loop has to expect that it is off: a true closure is not doubted."""
    doubted = solved(edge(0.0), edge(1.0, may_be_false=True)).poses[0].x_m
    expected = solved(edge(0.0), edge(1.0, may_be_false=True, gate=LOOSE))
    assert doubted < 0.2
    assert expected.poses[0].x_m == pytest.approx(0.5, abs=1e-6)
    assert expected.squared_residuals == pytest.approx([25.0, 25.0]), "these are weighed by the edge's information"


@pytest.mark.parametrize("axis", range(3))
def test_residuals_of_all_directions_are_judged(axis):
    """By the whole information, also where x, y and yaw are known together."""
    root = np.array([[10.0, 3.0, 1.0], [0.0, 12.0, -2.0], [0.0, 0.0, 20.0]])
    information = root.T @ root
    off = 0.4 * np.eye(3)[axis]
    held = Edge(1, ORIGIN, 0, ORIGIN, 1e6 * np.eye(3), may_be_false=False)
    false = Edge(1, Pose2D(*off.tolist()), 0, ORIGIN, information, may_be_false=True)
    solution = solved(held, false)
    square = off @ information @ off
    assert solution.squared_residuals[1] == pytest.approx(square, rel=2e-2)
    expected = np.linalg.inv(1e6 * np.eye(3) + weight_of(square) * information)
    assert solution.covariances[0] == pytest.approx(expected, rel=1e-4, abs=1e-12)


def test_what_edges_share_counts_for_the_covariance_only():
    solution = solved(edge(0.0, sure=0.5 * EVEN), edge(0.1, sure=0.5 * EVEN))
    assert solution.poses[0].x_m == pytest.approx(0.05), "each counts in full for the place"
    assert solution.covariances[0] == pytest.approx(np.linalg.inv(EVEN), abs=1e-12), "together as sure as one"
    solution = solved(edge(0.0, sure=0.5 * EVEN), edge(0.1))
    assert solution.covariances[0] == pytest.approx(np.linalg.inv(1.5 * EVEN), abs=1e-12)


def test_the_iteration_ends_even_if_an_edge_is_doubted_and_believed_in_turn():
    edges = [edge(0.3 * n, may_be_false=True) for n in range(8)]
    assert ITERATIONS_MAX == 10
    solution = solved(*edges)
    assert 0.0 < solution.poses[0].x_m < 2.1
