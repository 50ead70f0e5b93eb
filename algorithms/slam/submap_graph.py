"""One robot's part of the team's pose graph: the poses and loop closures of its submaps.

Each robot solves for its own submaps only and takes the poses that other robots publish for theirs. As all robots do so
in turn, the poses converge to the solution of the whole graph. This is distributed Gauss–Seidel (Choudhary et al.,
*Distributed mapping with privacy and communication constraints*, IJRR 2017). No robot solves the whole graph, and any
may be absent.
"""

import math
from collections import Counter
from collections.abc import Callable

import msgspec
import numpy as np

from robrain.algorithms.mapping.local_map import Variances
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import inverse, is_semidefinite
from robrain.algorithms.slam.pose_graph import Edge, solve
from robrain.algorithms.slam.submap_atlas import SubmapKey
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame

UNKNOWN = np.diag((1e4, 1e4, 10.0))
"""Covariance of an unknown place: m², m·rad, rad²."""
BEGINNING = np.diag((4e-4, 4e-4, 1e-4))
"""Covariance of a pose that defines a map frame: m², m·rad, rad²."""
INFORMATION_MAX = 1e9
"""Largest information of a loop closure, 1/m² and 1/rad²: a standard deviation of 0.03 mm."""


class GraphSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of the pose graph. They bound the time of a solution and the number of messages; none is critical."""

    submaps_max: int = 96
    """Number of own submaps that can still be moved; older ones stay where they are."""
    closures_per_pair: int = 2
    """Number of loop closures kept for each pair of submaps."""
    apart_m: float = 1.0
    """Least distance, metres, between two loop closures of the same pair."""
    closures_max: int = 512
    """Number of loop closures kept in all; 0 for a map that is never corrected."""
    moved_m: float = 0.01
    """A submap is moved if its correction exceeds this distance, metres …"""
    moved_rad: float = 0.002
    """… or this angle, radians."""


class OwnSubmap:
    """A node: one of the robot's own submaps.

    Args:
        number: of the submap.
        anchor: T_local_node, pose of the robot in the frame `local` when the submap began.
        T_arena_local: pose of that frame.
        trajectory: number that changes when the robot is lost and found again.
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
        """A pose in the frame `local`, relative to the node."""
        return self.anchor.inverse().compose(place)


class _Link(msgspec.Struct, eq=False):
    """A measured relative pose of an own submap and another submap, or the arena if `other` is None."""

    own: int
    at_own: Pose2D
    other: SubmapKey | None
    at_other: Pose2D
    """Pose in the other submap's frame `local`, or in the arena."""
    information: Floats
    """(3, 3), in the axes of `at_other`."""
    may_be_false: bool
    is_reported: bool = False
    """Whether the other robot found and published it; then the information is in the axes of `at_own`."""
    measured: Floats | None = None
    """Inverse of `information`, once it was needed."""

    def covariance(self) -> Floats:
        """(3, 3), in the axes of `information`."""
        if self.measured is None:
            self.measured = inverse(self.information)
        return self.measured


class SubmapGraph:
    """The pose graph of one robot.

    Args:
        robot: name of this robot.
        spec: limits.

    """

    def __init__(self, robot: str, spec: GraphSpec) -> None:
        self.spec = spec
        self.own: dict[int, OwnSubmap] = {}
        """Own submaps that can be moved, oldest first."""
        self._robot = robot
        self._steps: dict[int, _Link] = {}
        """For each own submap its pose relative to the one before, or in the arena."""
        self._closures: list[_Link] = []
        """Oldest first."""
        self.has_news = False
        """Whether anything has changed since the last `solve`."""

    @property
    def current(self) -> OwnSubmap | None:
        """The submap that scans are added to; None if there is none."""
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
        """Add the next own submap.

        Args:
            number: greater than those before.
            anchor: pose of the robot in the frame `local`.
            T_arena_local: pose of that frame.
            trajectory: between trajectories there is no measured relative pose.
            covariance: (3, 3) of the robot's pose relative to the beginning of the submap before or, for the first of a
                trajectory, in its map frame.
            frame: the map frame of `T_arena_local`.

        """
        before = self.current
        node = OwnSubmap(number, anchor, T_arena_local, trajectory, frame)
        if before is None or before.trajectory != trajectory:
            node.covariance = covariance
            self._steps[number] = self._placed(node, covariance, may_be_false=before is not None)
        else:
            node.covariance = _moved(before.covariance, before.pose, node.pose) + covariance
            place = Pose2D(anchor.x_m, anchor.y_m, 0.0)
            self._steps[number] = _Link(
                number,
                Pose2D(0.0, 0.0, -anchor.yaw_rad),
                (self._robot, before.number),
                place,
                inverse(covariance),
                may_be_false=False,
            )
        self.own[number] = node
        while len(self.own) > self.spec.submaps_max:
            self._freeze(next(iter(self.own)))

    def close(self, number: int, at_own: Pose2D, other: SubmapKey, at_other: Pose2D, information: Floats) -> None:
        """Add a loop closure: a pose in the frame of an own submap equals a pose in the frame of another submap.

        `information` (3, 3) is the inverse covariance of their difference, in the axes of `at_other`.
        """
        if number not in self.own:
            return
        link = _Link(number, self.own[number].at(at_own), other, at_other, information, may_be_false=True)
        self._keep(link, lambda each: each.at_other.distance_m(at_other))

    def add_robot_closure(
        self, number: int, at_own: Pose2D, other: SubmapKey, at_other: Pose2D, information: Floats
    ) -> None:
        """Add a loop closure that a teammate found by matching its scan to an own submap.

        `information` (3, 3) is in the axes of `at_own`, which are those of the own submap's frame.
        """
        node = self.own.get(number)
        if node is None or not is_information(information):
            return
        place = node.at(at_own)
        link = _Link(number, place, other, at_other, information, may_be_false=True, is_reported=True)
        self._keep(link, lambda each: each.at_own.distance_m(place))

    def change_frame(
        self, before: MapFrame, frame: MapFrame, T_new_old: Pose2D, at: Pose2D, covariance: Floats
    ) -> None:
        """A map frame has been found to lie in another one: its submaps are placed in that one from now on.

        Args:
            before: the previous frame.
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
                # The place where the frame began was known by definition. That is no place in the new frame.
                self._steps[node.number] = self._placed(node, UNKNOWN)
        if nearest is not None:
            # Places that were found in the old frame before are none in the new one; the covariance includes them.
            numbers = {node.number for node in moved}
            self._closures = [each for each in self._closures if each.other is not None or each.own not in numbers]
            self._closures.append(self._placed(nearest, nearest.covariance))
            self.has_news = True

    def part(self, trajectory: int, frame: MapFrame) -> None:
        """Give the submaps of a trajectory their own map frame, because they may lie wrong in the present one."""
        parted = {node.number for node in self.own.values() if node.trajectory == trajectory}
        if not parted:
            return
        first = self.own[min(parted)]
        for number in parted:
            self.own[number].frame = frame
        self._steps[first.number] = self._placed(first, BEGINNING, may_be_false=False)
        self._closures = [each for each in self._closures if (each.own in parted) == self._is_of(each.other, parted)]
        self.has_news = True

    def _is_of(self, key: SubmapKey | None, numbers: set[int]) -> bool:
        return key is not None and key[0] == self._robot and key[1] in numbers

    def _placed(self, node: OwnSubmap, covariance: Floats, *, may_be_false: bool = True) -> _Link:
        """A link that holds a node at its estimated pose, with this covariance."""
        at, turned = Pose2D(node.pose.x_m, node.pose.y_m, 0.0), Pose2D(0.0, 0.0, -node.pose.yaw_rad)
        return _Link(node.number, turned, None, at, inverse(covariance), may_be_false)

    def rests_on(self, robot: str) -> bool:
        """Whether there is a loop closure with a submap of this robot."""
        return any(each.other is not None and each.other[0] == robot for each in self._closures)

    def withdraw(self, number: int) -> None:
        """Remove an own submap that is wrong, with its loop closures."""
        self.own.pop(number, None)
        self._steps.pop(number, None)
        own = self._robot, number
        self._closures = [each for each in self._closures if each.own != number and each.other != own]

    def solve(
        self, place_of: Callable[[SubmapKey, MapFrame], Pose2D | None], variances_of: Callable[[SubmapKey], Variances]
    ) -> dict[int, Pose2D]:
        """Solve for the poses of the own submaps; returns the new T_arena_local of those that move.

        Args:
            place_of: returns T_arena_local, in a map frame, of another robot's submap or of an own one that cannot be
                moved. It returns None for a submap outside that frame.
            variances_of: returns the variances of that pose.

        """
        self.has_news = False
        numbers = list(self.own)
        index = {number: at for at, number in enumerate(numbers)}
        held: list[Pose2D] = [IDENTITY]
        held_at: dict[tuple[SubmapKey, MapFrame], int] = {}
        edges = []
        with_teammates = sum(each.other is not None and each.other[0] != self._robot for each in self._closures)
        for link in (*self._steps.values(), *self._closures):
            edge = self._edge(link, index, held, held_at, with_teammates, place_of, variances_of)
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
        with_teammates: int,
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
            gate = self._gate(link, node.covariance.diagonal())
            return Edge(index[other[1]], at_other, own, link.at_own, link.information, link.may_be_false, None, gate)
        key = other, frame
        if key not in held_at:
            place = place_of(other, frame)
            if place is None:
                return None
            held_at[key] = len(index) + len(held)
            held.append(place)
        # All scans that match a teammate's submaps share one error, and the teammates use this robot's poses in turn.
        # So all closures with teammates together give no smaller variance than that of one teammate, as in covariance
        # intersection.
        measured, teammates = link.covariance(), np.array(variances_of(other))
        information = inverse(_widened(measured, teammates))
        sure = inverse(_widened(measured, with_teammates * teammates))
        gate = self._gate(link, teammates)
        if link.is_reported:
            return Edge(own, link.at_own, held_at[key], link.at_other, information, link.may_be_false, sure, gate)
        return Edge(held_at[key], link.at_other, own, link.at_own, information, link.may_be_false, sure, gate)

    def _gate(self, link: _Link, other: Floats) -> Floats | None:
        """Information of the expected residual, in which the variances of both submaps count as well."""
        if not link.may_be_false:
            return None
        own = self.own[link.own].covariance.diagonal()
        return inverse(_widened(_widened(link.covariance(), own), other))

    def _keep(self, link: _Link, away_m: Callable[[_Link], float]) -> None:
        """Add a closure. It replaces those of the same pair that are near it or, if there is none, the oldest ones."""
        same = [each for each in self._closures if (each.own, each.other) == (link.own, link.other)]
        near = [each for each in same if away_m(each) < self.spec.apart_m]
        for each in near or same[: max(0, len(same) + 1 - self.spec.closures_per_pair)]:
            self._closures.remove(each)
        if not self.spec.closures_max:
            return
        if len(self._closures) >= self.spec.closures_max:
            # Drop one of the robot that has published most, so that no teammate displaces the closures of all others.
            tellers = [_teller(each) for each in self._closures]
            del self._closures[tellers.index(Counter(tellers).most_common(1)[0][0])]
        self._closures.append(link)
        self.has_news = True

    def _freeze(self, number: int) -> None:
        """Fix an own submap at its current pose."""
        del self.own[number]
        del self._steps[number]
        self._closures = [each for each in self._closures if each.own != number]


def _widened(covariance: Floats, variances: Floats) -> Floats:
    """A (3, 3) covariance to which variances (3,) are added."""
    widened = covariance.copy()
    widened.ravel()[::4] += variances
    return widened


def _moved(covariance: Floats, before: Pose2D, now: Pose2D) -> Floats:
    """A pose's covariance after an exact movement: an error in its yaw has moved it across its path."""
    xx, xy, xt, _, yy, yt, _, _, tt = covariance.ravel().tolist()
    dx_m, dy_m = now.x_m - before.x_m, now.y_m - before.y_m
    moved_xt, moved_yt = xt - dy_m * tt, yt + dx_m * tt
    moved_xx, moved_yy = xx - dy_m * (xt + moved_xt), yy + dx_m * (yt + moved_yt)
    moved_xy = xy + dx_m * xt - dy_m * moved_yt
    return np.array(((moved_xx, moved_xy, moved_xt), (moved_xy, moved_yy, moved_yt), (moved_xt, moved_yt, tt)))


def _turned(covariance: Floats, yaw_rad: float) -> Floats:
    """A (3, 3) covariance of x, y, yaw in axes that are turned by `yaw_rad` against its own."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = covariance.tolist()
    turned_xx = cos * cos * xx - 2 * cos * sin * xy + sin * sin * yy
    turned_yy = sin * sin * xx + 2 * cos * sin * xy + cos * cos * yy
    turned_xy = cos * sin * (xx - yy) + (cos * cos - sin * sin) * xy
    turned_xt, turned_yt = cos * xt - sin * yt, sin * xt + cos * yt
    return np.array([[turned_xx, turned_xy, turned_xt], [turned_xy, turned_yy, turned_yt], [turned_xt, turned_yt, tt]])


def _teller(link: _Link) -> str | None:
    """Robot that published a closure; None if this robot found it."""
    return link.other[0] if link.is_reported and link.other is not None else None


def is_information(matrix: Floats) -> bool:
    """Whether a symmetric (3, 3) matrix can be the inverse covariance of a loop closure."""
    return 0.0 < max(matrix.diagonal().tolist()) <= INFORMATION_MAX and is_semidefinite(matrix)
