"""One robot's submaps in the pose graph: what it knows of where each lies, and the loop closures between them.

Each robot places its own submaps; those of others it takes to be where the others say. As every robot does so in turn,
the team's poses converge to those of the whole graph (distributed Gauss–Seidel: Choudhary et al., *Distributed mapping
with privacy and communication constraints*, IJRR 2017). Nobody has to solve for all, and nobody has to be there.
"""

import math
from collections import deque
from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.local_map import Variances
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
from robrain.protocol.model.mapping.pose_graph import Edge, solve
from robrain.protocol.model.mapping.submap import IDENTITY
from robrain.protocol.model.mapping.submap_atlas import SubmapKey

Floats = NDArray[np.float64]


UNKNOWN = np.diag((1e4, 1e4, 10.0))
"""Covariance of a place of which nothing is known: m², m·rad, rad²."""
BEGINNING = np.diag((4e-4, 4e-4, 1e-4))
"""Covariance of a pose that defines a map frame: m², m·rad, rad²."""
INFORMATION_MAX = 1e9
"""Of a loop closure: nobody knows a place to 0.03 mm."""


class GraphSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How sure things are in the pose graph, and how much of it is kept. All are chosen."""

    submaps_max: int = 96
    """Own submaps that can still be moved; older ones stay where they are."""
    closures_per_pair: int = 2
    apart_m: float = 1.0
    """Two closures of a pair of submaps are at least so far apart."""
    closures_max: int = 512
    moved_m: float = 0.01
    """A submap is moved where it would move by more than this …"""
    moved_rad: float = 0.002
    """… or turn by more than this."""


class OwnSubmap:
    """A node: one of the robot's own submaps.

    Args:
        number: of the submap.
        anchor: T_local_node, the robot's place in the submap's frame when it began.
        T_arena_local: where that frame lies.
        trajectory: submaps of one trajectory were seen without losing the place in between.
        frame: the map frame of `T_arena_local`.

    """

    def __init__(
        self, number: int, anchor: Pose2D, T_arena_local: Pose2D, trajectory: int, frame: MapFrame = ARENA
    ) -> None:
        self.number = number
        self.anchor = anchor
        self.T_arena_local = T_arena_local
        self.trajectory = trajectory
        self.frame = frame
        self.covariance: Floats = np.zeros((3, 3))

    @property
    def pose(self) -> Pose2D:
        """T_arena_node."""
        return self.T_arena_local.compose(self.anchor)

    def at(self, place: Pose2D) -> Pose2D:
        """A place of the submap's frame, seen from the node."""
        return self.anchor.inverse().compose(place)


class _Link(msgspec.Struct):
    """What is known between one own submap and another submap, or the arena if `other` is None."""

    own: int
    at_own: Pose2D
    other: SubmapKey | None
    at_other: Pose2D
    """In the other's frame `local`, or in the arena."""
    information: Floats
    """(3, 3), in the axes of `at_other`."""
    may_be_false: bool
    axes_of_own: bool = False
    """Whether the information is in the axes of `at_own` instead."""


class SubmapGraph:
    """The pose graph of one robot.

    Args:
        robot: whose submaps are placed.
        spec: how sure things are.

    """

    def __init__(self, robot: str, spec: GraphSpec) -> None:
        self.spec = spec
        self.own: dict[int, OwnSubmap] = {}
        """Own submaps that can be moved, in the order in which they were begun."""
        self._robot = robot
        self._steps: dict[int, _Link] = {}
        """By own submap: how it follows the one before, or where it is known to be."""
        self._closures: deque[_Link] = deque(maxlen=spec.closures_max)
        self.has_news = False
        """Whether something became known since the last `solve`."""

    @property
    def current(self) -> OwnSubmap | None:
        """The submap that the robot is making."""
        return next(reversed(self.own.values()), None)

    def begin(
        self,
        number: int,
        anchor: Pose2D,
        T_arena_local: Pose2D,
        trajectory: int,
        covariance: Floats,
        frame: MapFrame = ARENA,
    ) -> None:
        """The robot begins a submap.

        Args:
            number: greater than those before.
            anchor: the robot's place in the frame `local`.
            T_arena_local: of that frame.
            trajectory: the first submap of a trajectory does not follow from the one before.
            covariance: (3, 3) of the robot's pose: against where the submap before began, or, for the first of a
                trajectory, in its map frame.
            frame: the map frame of `T_arena_local`.

        """
        before = self.current
        node = OwnSubmap(number, anchor, T_arena_local, trajectory, frame)
        if before is None or before.trajectory != trajectory:
            node.covariance = covariance
            self._steps[number] = self._placed(node, covariance, may_be_false=before is not None)
        else:
            node.covariance = before.covariance + covariance
            # The yaw of the submap before moves this one.
            across_m2 = 0.5 * before.covariance[2, 2] * before.anchor.distance_m(anchor) ** 2
            node.covariance[0, 0] += across_m2
            node.covariance[1, 1] += across_m2
            place = Pose2D(anchor.x_m, anchor.y_m, 0.0)
            self._steps[number] = _Link(
                number,
                Pose2D(0.0, 0.0, -anchor.yaw_rad),
                (self._robot, before.number),
                place,
                _inverse(covariance),
                may_be_false=False,
            )
        self.own[number] = node
        while len(self.own) > self.spec.submaps_max:
            self._freeze(next(iter(self.own)))

    def close(self, number: int, at_own: Pose2D, other: SubmapKey, at_other: Pose2D, information: Floats) -> None:
        """A place in the frame of an own submap is a place in the frame of another submap: a loop closure.

        `information` (3, 3) is that of the difference, in the axes of `at_other`.
        """
        if number not in self.own:
            return
        link = _Link(number, self.own[number].at(at_own), other, at_other, information, may_be_false=True)
        same = [each for each in self._closures if (each.own, each.other) == (number, other)]
        near = [each for each in same if each.at_other.distance_m(at_other) < self.spec.apart_m]
        worse = near or same[: max(0, len(same) + 1 - self.spec.closures_per_pair)]
        for each in worse:
            self._closures.remove(each)
        self._closures.append(link)
        self.has_news = True

    def close_with_mate(
        self, number: int, at_own: Pose2D, other: SubmapKey, at_other: Pose2D, information: Floats
    ) -> None:
        """A mate's scan lies on an own submap; `information` is in the axes of `at_own`, which are the own frame's."""
        node = self.own.get(number)
        if node is None or not is_information(information):
            return
        same = [each for each in self._closures if (each.own, each.other) == (number, other)]
        place = node.at(at_own)
        near = [each for each in same if each.at_own.distance_m(place) < self.spec.apart_m]
        for each in near or same[: max(0, len(same) + 1 - self.spec.closures_per_pair)]:
            self._closures.remove(each)
        self._closures.append(_Link(number, place, other, at_other, information, True, axes_of_own=True))
        self.has_news = True

    def change_frame(
        self, before: MapFrame, frame: MapFrame, T_new_old: Pose2D, at: Pose2D, covariance: Floats
    ) -> None:
        """A map frame has been found to lie in another one: its submaps are placed in that one from now on.

        Args:
            before: the frame that is left.
            frame: the one in which its submaps are placed now.
            T_new_old: how the old frame lies in the new one.
            at: where in the new frame that was found: there it is right by …
            covariance: … (3, 3) m², m·rad, rad², in the axes of the new frame.

        """
        moved = [node for node in self.own.values() if node.frame == before]
        nearest = min(moved, key=lambda node: T_new_old.compose(node.pose).distance_m(at), default=None)
        for node in moved:
            node.T_arena_local, node.frame = T_new_old.compose(node.T_arena_local), frame
            away_m2 = 0.5 * float(covariance[2, 2]) * node.pose.distance_m(at) ** 2
            node.covariance = _turned(node.covariance, T_new_old.yaw_rad) + covariance
            node.covariance[0, 0] += away_m2
            node.covariance[1, 1] += away_m2
            step = self._steps[node.number]
            if step.other is None:
                # Where the frame began was known by definition. That is no place in the new frame.
                self._steps[node.number] = self._placed(node, UNKNOWN)
        if nearest is not None:
            self._closures.append(self._placed(nearest, nearest.covariance))
            self.has_news = True

    def part(self, trajectory: int, frame: MapFrame) -> None:
        """The submaps of a trajectory may lie wrong in their map frame: they lie in one of their own from now on."""
        parted = {node.number for node in self.own.values() if node.trajectory == trajectory}
        if not parted:
            return
        first = self.own[min(parted)]
        for number in parted:
            self.own[number].frame = frame
        self._steps[first.number] = self._placed(first, BEGINNING, may_be_false=False)
        kept = [each for each in self._closures if (each.own in parted) == self._is_of(each.other, parted)]
        self._closures.clear()
        self._closures.extend(kept)
        self.has_news = True

    def _is_of(self, key: SubmapKey | None, numbers: set[int]) -> bool:
        return key is not None and key[0] == self._robot and key[1] in numbers

    def _placed(self, node: OwnSubmap, covariance: Floats, *, may_be_false: bool = True) -> _Link:
        """A node lies where it is believed to, give or take this."""
        at, turned = Pose2D(node.pose.x_m, node.pose.y_m, 0.0), Pose2D(0.0, 0.0, -node.pose.yaw_rad)
        return _Link(node.number, turned, None, at, _inverse(covariance), may_be_false)

    def rests_on(self, robot: str) -> bool:
        """Whether a closure holds own submaps against those of another robot."""
        return any(each.other is not None and each.other[0] == robot for each in self._closures)

    def withdraw(self, number: int) -> None:
        """An own submap is wrong: nothing rests on it any more."""
        self.own.pop(number, None)
        self._steps.pop(number, None)
        kept = [each for each in self._closures if each.own != number and each.other != (self._robot, number)]
        self._closures.clear()
        self._closures.extend(kept)

    def solve(
        self, place_of: Callable[[SubmapKey, MapFrame], Pose2D | None], variances_of: Callable[[SubmapKey], Variances]
    ) -> dict[int, Pose2D]:
        """Place the own submaps anew; T_arena_local of those that move.

        Args:
            place_of: T_arena_local, in a map frame, of another robot's submap or of an own one that cannot be moved;
                None if it does not lie in that frame.
            variances_of: of that place.

        """
        self.has_news = False
        numbers = list(self.own)
        index = {number: at for at, number in enumerate(numbers)}
        held: list[Pose2D] = [IDENTITY]
        held_at: dict[tuple[SubmapKey, MapFrame], int] = {}
        edges = []
        for link in (*self._steps.values(), *self._closures):
            edge = self._edge(link, index, held, held_at, place_of, variances_of)
            if edge is not None:
                edges.append(edge)
        solution = solve([self.own[number].pose for number in numbers], held, edges)
        if solution is None:
            return {}
        moved = {}
        for at, number in enumerate(numbers):
            node = self.own[number]
            node.covariance = solution.covariances[at]
            pose = solution.poses[at]
            turned_rad = abs(math.remainder(pose.yaw_rad - node.pose.yaw_rad, math.tau))
            if pose.distance_m(node.pose) > self.spec.moved_m or turned_rad > self.spec.moved_rad:
                node.T_arena_local = pose.compose(node.anchor.inverse())
                moved[number] = node.T_arena_local
        return moved

    def _edge(
        self,
        link: _Link,
        index: dict[int, int],
        held: list[Pose2D],
        held_at: dict[tuple[SubmapKey, MapFrame], int],
        place_of: Callable[[SubmapKey, MapFrame], Pose2D | None],
        variances_of: Callable[[SubmapKey], Variances],
    ) -> Edge | None:
        own, other = index[link.own], link.other
        frame = self.own[link.own].frame
        if other is None:
            return Edge(len(index), link.at_other, own, link.at_own, link.information, link.may_be_false)
        if other[0] == self._robot and other[1] in index:
            if self.own[other[1]].frame != frame:
                return None
            at_other = self.own[other[1]].at(link.at_other)
            node = self.own[other[1]]
            gate = self._gate(link, np.diag(np.diag(node.covariance)))
            return Edge(index[other[1]], at_other, own, link.at_own, link.information, link.may_be_false, None, gate)
        key = other, frame
        if key not in held_at:
            place = place_of(other, frame)
            if place is None:
                return None
            held_at[key] = len(index) + len(held)
            held.append(place)
        # A mate's place is measured only once, however many scans lie there, and mates go by this robot in their turn:
        # all closures with mates together make the robot no surer than one mate is (covariance intersection).
        measured, mates = _inverse(link.information), np.diag(variances_of(other))
        information, sure = _inverse(measured + mates), _inverse(measured + self._with_mates() * mates)
        gate = self._gate(link, mates)
        if link.axes_of_own:
            return Edge(own, link.at_own, held_at[key], link.at_other, information, link.may_be_false, sure, gate)
        return Edge(held_at[key], link.at_other, own, link.at_own, information, link.may_be_false, sure, gate)

    def _gate(self, link: _Link, other: Floats) -> Floats | None:
        """Information of the difference that is to be expected: what both submaps may be off counts as well."""
        if not link.may_be_false:
            return None
        own = np.diag(np.diag(self.own[link.own].covariance))
        return _inverse(_inverse(link.information) + own + other)

    def _with_mates(self) -> int:
        return sum(each.other is not None and each.other[0] != self._robot for each in self._closures)

    def _freeze(self, number: int) -> None:
        """Let an own submap stay where it is; what follows from it follows from there."""
        del self.own[number]
        del self._steps[number]
        kept = [each for each in self._closures if each.own != number]
        self._closures.clear()
        self._closures.extend(kept)


def _turned(covariance: Floats, yaw_rad: float) -> Floats:
    """A (3, 3) covariance of x, y, yaw in axes that are turned by `yaw_rad` against its own."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = covariance.tolist()
    turned_xx = cos * cos * xx - 2 * cos * sin * xy + sin * sin * yy
    turned_yy = sin * sin * xx + 2 * cos * sin * xy + cos * cos * yy
    turned_xy = cos * sin * (xx - yy) + (cos * cos - sin * sin) * xy
    turned_xt, turned_yt = cos * xt - sin * yt, sin * xt + cos * yt
    return np.array([[turned_xx, turned_xy, turned_xt], [turned_xy, turned_yy, turned_yt], [turned_xt, turned_yt, tt]])


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a symmetric, positive semi-definite (3, 3) matrix, by its adjugate, made definite by a small share."""
    (a, b, c), (_, d, e), (_, _, f) = matrix.tolist()
    lift = 1e-9 * (a + d + f) + 1e-12
    a, d, f = a + lift, d + lift, f + lift
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    inverse: Floats = (
        np.array(
            [
                [d * f - e * e, c * e - b * f, b * e - c * d],
                [c * e - b * f, a * f - c * c, b * c - a * e],
                [b * e - c * d, b * c - a * e, a * d - b * b],
            ]
        )
        / determinant
    )
    return inverse


def symmetric(upper: tuple[float, ...]) -> Floats:
    """A symmetric (3, 3) matrix from its upper triangle, row by row."""
    a, b, c, d, e, f = upper
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def is_information(matrix: Floats) -> bool:
    """Whether a symmetric (3, 3) matrix can be the inverse of a covariance: no principal minor is negative."""
    (a, b, c), (_, d, e), (_, _, f) = matrix.tolist()
    largest = max(a, d, f)
    if not 0.0 < largest <= INFORMATION_MAX:
        return False
    small = 1e-9 * largest
    minors = a * d - b * b, a * f - c * c, d * f - e * e
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return bool(min(a, d, f) >= 0.0 and min(minors) >= -small * largest and determinant >= -small * largest**2)
