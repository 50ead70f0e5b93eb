import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.slam.pose_graph import Edge, solve
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


@pytest.mark.parametrize("step", [STEP, Pose2D(1.0, 0.5, 0.7), Pose2D(0.3, -2.0, -2.5)])
def test_a_chain_comes_to_lie_as_its_steps_say_wherever_it_begins(step):
    expected = [step]
    for _ in range(5):
        expected.append(expected[-1].compose(step))
    begun = [Pose2D(p.x_m + 0.2, p.y_m - 0.3, p.yaw_rad + 0.1) for p in expected]
    solution = solve(begun, [ORIGIN], chain(6, step))
    assert solution is not None
    for pose, place in zip(solution.poses, expected, strict=True):
        assert off(pose, place) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert max(solution.squared_residuals) < 1e-9


@pytest.mark.parametrize(("may_be_false", "pulled_m"), [(True, 0.01), (False, 1.0)])
def test_a_false_loop_closure_loses_its_weight_if_it_may_be_false(may_be_false, pulled_m):
    places = [Pose2D((n + 1) * STEP.x_m, 0.0, 0.0) for n in range(5)]
    false = Edge(5, Pose2D(4.0, 6.0, 1.0), 4, ORIGIN, EVEN, may_be_false)
    solution = solve(places, [ORIGIN], [*chain(5), false])
    assert solution is not None
    far_m = solution.poses[4].distance_m(places[4])
    assert far_m < pulled_m if may_be_false else far_m > pulled_m
    assert (solution.squared_residuals[-1] > 1000.0) == may_be_false


def test_a_true_loop_closure_that_may_be_false_counts_in_full():
    places = [Pose2D((n + 1) * STEP.x_m, 0.0, 0.0) for n in range(3)]
    closure = [Edge(3, Pose2D(6.03, 0.02, 0.005), 2, ORIGIN, EVEN, doubt) for doubt in (True, False)]
    doubted, sure = (solve(places, [ORIGIN], [*chain(3), each]) for each in closure)
    assert doubted is not None
    assert sure is not None
    assert doubted.poses == sure.poses
    assert doubted.poses[2].x_m > 6.01


@given(held=PLACE, at_one=PLACE, at_other=PLACE)
@settings(deadline=None)
def test_places_away_from_the_nodes_are_put_together_from_either_side(held, at_one, at_other):
    expected = held.compose(at_one).compose(at_other.inverse())
    begun = Pose2D(expected.x_m + 0.1, expected.y_m - 0.1, expected.yaw_rad + 0.05)
    for edge in (
        Edge(1, at_one, 0, at_other, EVEN, may_be_false=False),
        Edge(0, at_other, 1, at_one, EVEN, may_be_false=False),
    ):
        solution = solve([begun], [held], [edge])
        assert solution is not None
        assert off(solution.poses[0], expected) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


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
    assert least == pytest.approx(sum(solution.squared_residuals), rel=1e-3, abs=1e-6)
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


def test_a_graph_without_free_nodes_is_solved():
    solution = solve([], [ORIGIN, STEP], [follows(0, 1, STEP)])
    assert solution is not None
    assert solution.poses == []
    assert solution.squared_residuals == pytest.approx([0.0])
