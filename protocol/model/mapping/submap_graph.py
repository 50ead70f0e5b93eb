"""One robot's submaps in the pose graph: what it knows of where each lies, and the loop closures between them.

Each robot places its own submaps; those of others it takes to be where the others say. As every robot does so in turn,
the team's poses converge to those of the whole graph (distributed Gauss–Seidel: Choudhary et al., *Distributed mapping
with privacy and communication constraints*, IJRR 2017). Nobody has to solve for all, and nobody has to be there.
"""

import math
from collections import Counter
from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.local_map import Variances
from robrain.protocol.model.mapping.pose_graph import Edge, solve
from robrain.protocol.model.mapping.submap import IDENTITY
from robrain.protocol.model.mapping.submap_atlas import SubmapKey
from robrain.protocol.model.small_linear_algebra import inverse, is_semidefinite

Floats = NDArray[np.float64]
INFORMATION_MAX = 1e9
"""Largest information of a loop closure, 1/m² and 1/rad²: a standard deviation of 0.03 mm."""


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

    """

    def __init__(self, number: int, anchor: Pose2D, T_arena_local: Pose2D, trajectory: int) -> None:
        self.number = number
        self.anchor = anchor
        self.T_arena_local = T_arena_local
        self.trajectory = trajectory
        self.covariance: Floats = np.zeros((3, 3))

    @property
    def pose(self) -> Pose2D:
        """T_arena_node."""
        return self.T_arena_local.compose(self.anchor)

    def at(self, place: Pose2D) -> Pose2D:
        """A place of the submap's frame, seen from the node."""
        return self.anchor.inverse().compose(place)


class _Link(msgspec.Struct, eq=False):
    """What is known between one own submap and another submap, or the arena if `other` is None."""

    own: int
    at_own: Pose2D
    other: SubmapKey | None
    at_other: Pose2D
    """In the other's frame `local`, or in the arena."""
    information: Floats
    """(3, 3), in the axes of `at_other`."""
    may_be_false: bool
    told: bool = False
    """Whether the other robot found it; then the information is in the axes of `at_own`."""


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
        self._closures: list[_Link] = []
        """Oldest first."""
        self.has_news = False
        """Whether something became known since the last `solve`."""

    @property
    def current(self) -> OwnSubmap | None:
        """The submap that the robot is making."""
        return next(reversed(self.own.values()), None)

    def begin(self, number: int, anchor: Pose2D, T_arena_local: Pose2D, trajectory: int, covariance: Floats) -> None:
        """The robot begins a submap.

        Args:
            number: greater than those before.
            anchor: the robot's place in the frame `local`.
            T_arena_local: of that frame.
            trajectory: the first submap of a trajectory does not follow from the one before.
            covariance: (3, 3) of the robot's pose: against where the submap before began, or, for the first of a
                trajectory, in the arena.

        """
        before = self.current
        node = OwnSubmap(number, anchor, T_arena_local, trajectory)
        if before is None or before.trajectory != trajectory:
            node.covariance = covariance
            at, turned = Pose2D(node.pose.x_m, node.pose.y_m, 0.0), Pose2D(0.0, 0.0, -node.pose.yaw_rad)
            self._steps[number] = _Link(number, turned, None, at, inverse(covariance), before is not None)
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
                inverse(covariance),
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
        self._keep(link, lambda each: each.at_other.distance_m(at_other))

    def close_with_mate(
        self, number: int, at_own: Pose2D, other: SubmapKey, at_other: Pose2D, information: Floats
    ) -> None:
        """A mate's scan lies on an own submap; `information` is in the axes of `at_own`, which are the own frame's."""
        node = self.own.get(number)
        if node is None or not is_information(information):
            return
        place = node.at(at_own)
        link = _Link(number, place, other, at_other, information, may_be_false=True, told=True)
        self._keep(link, lambda each: each.at_own.distance_m(place))

    def rests_on(self, robot: str) -> bool:
        """Whether a closure holds own submaps against those of another robot."""
        return any(each.other is not None and each.other[0] == robot for each in self._closures)

    def withdraw(self, number: int) -> None:
        """An own submap is wrong: nothing rests on it any more."""
        self.own.pop(number, None)
        self._steps.pop(number, None)
        own = self._robot, number
        self._closures = [each for each in self._closures if each.own != number and each.other != own]

    def solve(
        self, place_of: Callable[[SubmapKey], Pose2D | None], variances_of: Callable[[SubmapKey], Variances]
    ) -> dict[int, Pose2D]:
        """Place the own submaps anew; T_arena_local of those that move.

        Args:
            place_of: T_arena_local of another robot's submap, or of an own one that cannot be moved; None if not known.
            variances_of: of that place.

        """
        self.has_news = False
        numbers = list(self.own)
        index = {number: at for at, number in enumerate(numbers)}
        held: list[Pose2D] = [IDENTITY]
        held_at: dict[SubmapKey, int] = {}
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
        held_at: dict[SubmapKey, int],
        place_of: Callable[[SubmapKey], Pose2D | None],
        variances_of: Callable[[SubmapKey], Variances],
    ) -> Edge | None:
        own, other = index[link.own], link.other
        if other is None:
            return Edge(len(index), link.at_other, own, link.at_own, link.information, link.may_be_false)
        if other[0] == self._robot and other[1] in index:
            at_other = self.own[other[1]].at(link.at_other)
            node = self.own[other[1]]
            gate = self._gate(link, np.diag(np.diag(node.covariance)))
            return Edge(index[other[1]], at_other, own, link.at_own, link.information, link.may_be_false, None, gate)
        if other not in held_at:
            place = place_of(other)
            if place is None:
                return None
            held_at[other] = len(index) + len(held)
            held.append(place)
        # A mate's place is measured only once, however many scans lie there, and mates go by this robot in their turn:
        # all closures with mates together make the robot no surer than one mate is (covariance intersection).
        measured, mates = inverse(link.information), np.diag(variances_of(other))
        information, sure = inverse(measured + mates), inverse(measured + self._with_mates() * mates)
        gate = self._gate(link, mates)
        if link.told:
            return Edge(own, link.at_own, held_at[other], link.at_other, information, link.may_be_false, sure, gate)
        return Edge(held_at[other], link.at_other, own, link.at_own, information, link.may_be_false, sure, gate)

    def _gate(self, link: _Link, other: Floats) -> Floats | None:
        """Information of the difference that is to be expected: what both submaps may be off counts as well."""
        if not link.may_be_false:
            return None
        own = np.diag(np.diag(self.own[link.own].covariance))
        return inverse(inverse(link.information) + own + other)

    def _keep(self, link: _Link, away_m: Callable[[_Link], float]) -> None:
        """Keep a closure in place of those of the same pair that are near it or, if none is, of the oldest."""
        same = [each for each in self._closures if (each.own, each.other) == (link.own, link.other)]
        near = [each for each in same if away_m(each) < self.spec.apart_m]
        for each in near or same[: max(0, len(same) + 1 - self.spec.closures_per_pair)]:
            self._closures.remove(each)
        if self._closures and len(self._closures) >= self.spec.closures_max:
            # Of the robot that has told most, so that no mate can displace the closures of all others.
            tellers = [_teller(each) for each in self._closures]
            del self._closures[tellers.index(Counter(tellers).most_common(1)[0][0])]
        self._closures.append(link)
        self.has_news = True

    def _with_mates(self) -> int:
        return sum(each.other is not None and each.other[0] != self._robot for each in self._closures)

    def _freeze(self, number: int) -> None:
        """Let an own submap stay where it is; what follows from it follows from there."""
        del self.own[number]
        del self._steps[number]
        self._closures = [each for each in self._closures if each.own != number]


def _teller(link: _Link) -> str | None:
    """The robot that told of a closure; None for one that this robot found itself."""
    return link.other[0] if link.told and link.other is not None else None


def is_information(matrix: Floats) -> bool:
    """Whether a symmetric (3, 3) matrix can be the inverse covariance of a loop closure."""
    return 0.0 < max(matrix.diagonal().tolist()) <= INFORMATION_MAX and is_semidefinite(matrix)
