"""What an edge is judged by (`gate`), and what counts for the covariances (`sure`)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.slam.pose_graph import SCALING, Edge, solve
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.slam.submap_walks import off

ORIGIN = Pose2D(0.0, 0.0, 0.0)
SIGMA_M, SIGMA_RAD = 0.05, 0.02
EVEN = np.diag((SIGMA_M**-2, SIGMA_M**-2, SIGMA_RAD**-2))
STEP = Pose2D(2.0, 0.0, 0.0)
PLACE = st.builds(Pose2D, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.1, 3.1))


def follows(one, other, step=STEP, information=EVEN, *, may_be_false=False):
    return Edge(one, step, other, ORIGIN, information, may_be_false)


def chain(count, step=STEP):
    """Nodes 0 to count − 1 in a row, the first of which follows from the held node `count`."""
    return [follows(count, 0, step)] + [follows(node, node + 1, step) for node in range(count - 1)]


def residual(edge, poses):
    """As the module's docstring has it: the difference other − one in the axes of `at_one`."""
    one = poses[edge.one].compose(edge.at_one)
    other = poses[edge.other].compose(edge.at_other)
    dx, dy, turn = off(other, one)
    cos, sin = math.cos(one.yaw_rad), math.sin(one.yaw_rad)
    return np.array((cos * dx + sin * dy, -sin * dx + cos * dy, turn))


def cost(edges, poses):
    return sum(float(residual(edge, poses) @ edge.information @ residual(edge, poses)) for edge in edges)


def nudged(poses, values):
    moved = [Pose2D(p.x_m + v[0], p.y_m + v[1], p.yaw_rad + v[2]) for p, v in zip(poses, values, strict=False)]
    return [*moved, *poses[len(values) :]]


@pytest.mark.parametrize(("may_be_false", "pulled_m"), [(True, 0.01), (False, 1.0)])
def test_a_false_loop_closure_loses_its_weight_if_it_may_be_false(may_be_false, pulled_m):
    places = [Pose2D((n + 1) * STEP.x_m, 0.0, 0.0) for n in range(5)]
    false = Edge(5, Pose2D(4.0, 6.0, 1.0), 4, ORIGIN, EVEN, may_be_false)
    solution = solve(places, [ORIGIN], [*chain(5), false])
    assert solution is not None
    far_m = solution.poses[4].distance_m(places[4])
    assert far_m < pulled_m if may_be_false else far_m > pulled_m


@pytest.mark.slow
@given(st.data())
@settings(deadline=None, max_examples=20)
def test_no_place_near_the_solution_is_likelier_and_the_covariance_is_its_curvature(data):
    places = data.draw(st.lists(PLACE, min_size=3, max_size=3))
    held = [ORIGIN, data.draw(PLACE)]
    small = st.floats(-0.05, 0.05)
    true = [*places, *held]
    edges = []
    for one, other in ((3, 0), (0, 1), (1, 2), (2, 4), (0, 2)):
        at_one, wrong = data.draw(PLACE), data.draw(st.builds(Pose2D, small, small, small))
        at_other = true[other].inverse().compose(true[one].compose(at_one)).compose(wrong)
        root = np.array([[data.draw(st.floats(5.0, 20.0)) * (i == j) + (i > j) for j in range(3)] for i in range(3)])
        edges.append(Edge(one, at_one, other, at_other, root @ root.T, may_be_false=False))
    solution = solve(places, held, edges)
    assert solution is not None
    found = [*solution.poses, *held]
    least = cost(edges, found)
    step = 1e-3

    def at(values):
        return cost(edges, nudged(found, np.reshape(values, (3, 3))))

    hessian = np.zeros((9, 9))
    unit = np.eye(9) * step
    for i in range(9):
        assert at(unit[i]) > least - 1e-6
        assert at(-unit[i]) > least - 1e-6
        for j in range(9):
            ends = at(unit[i] + unit[j]) - at(unit[i] - unit[j]) - at(unit[j] - unit[i]) + at(-unit[i] - unit[j])
            hessian[i, j] = ends / (8.0 * step**2)  # the cost is twice the negative logarithm of the likelihood
    curvature = np.linalg.inv(hessian)
    for n in range(3):
        expected = curvature[3 * n : 3 * n + 3, 3 * n : 3 * n + 3]
        assert solution.covariances[n] == pytest.approx(expected, rel=0.2, abs=0.1 * float(np.abs(expected).max()))


@given(places=st.lists(PLACE, min_size=2, max_size=4), step=PLACE)
@settings(deadline=None)
def test_nodes_that_hang_on_nothing_that_is_held_are_not_determined(places, step):
    edges = [follows(node, node + 1, step) for node in range(len(places) - 1)]
    assert solve(places, [ORIGIN], edges) is None
    assert solve(places, [ORIGIN], [*edges, follows(len(places), 0, step)]) is not None


JUDGED = np.diag((100.0, 100.0, 400.0))
LOOSE = np.diag((1.0, 1.0, 4.0))


def edge(at_m, information=JUDGED, *, may_be_false=False, sure=None, gate=None):
    """The held node 1 says that the free node 0 is there."""
    return Edge(1, Pose2D(at_m, 0.0, 0.0), 0, ORIGIN, information, may_be_false, sure, gate)


def solved(*edges, begun=ORIGIN):
    solution = solve([begun], [ORIGIN], list(edges))
    assert solution is not None
    return solution


def weight_of(expected):
    """Dynamic covariance scaling: s² with s = 2Φ / (Φ + χ²), at most 1."""
    return min(1.0, 2.0 * SCALING / (SCALING + expected)) ** 2


def test_the_weight_of_a_doubtful_edge_is_that_of_dynamic_covariance_scaling():
    """Where the two pull alike, the weights are those of the residuals that are left."""
    apart_m = 1.0
    solution = solved(edge(0.0), edge(apart_m, may_be_false=True))
    x_m = solution.poses[0].x_m
    weight = weight_of(100.0 * (apart_m - x_m) ** 2)
    assert weight < 0.2
    assert x_m == pytest.approx(weight * (apart_m - x_m), rel=1e-3)
    assert solution.covariances[0][0, 0] == pytest.approx(1.0 / (100.0 * (1.0 + weight)), rel=1e-3)


def test_an_edge_is_judged_by_what_its_residual_may_be_and_weighs_as_it_is_known():
    """A robot that has gone far without closing a loop has to expect that it is off: a true closure is not doubted."""
    doubted = solved(edge(0.0), edge(1.0, may_be_false=True)).poses[0].x_m
    expected = solved(edge(0.0), edge(1.0, may_be_false=True, gate=LOOSE))
    assert doubted < 0.2
    assert expected.poses[0].x_m == pytest.approx(0.5, abs=1e-6)
