"""The map frame of a robot, and its change to the team's frame.

A robot that does not know its place maps in its own frame. It searches for its map on the maps of better frames. All
its submaps move when several searches, from places apart, have found the same answer. This is pairwise consistency
(Mangelson et al., *Pairwise consistent measurement set maximization*, ICRA 2018). Teammates that mapped in the
abandoned frame follow by themselves.
"""

import logging
import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robrain.algorithms.mapping.local_map import ArenaFix
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import inverse_form
from robrain.algorithms.slam.map_overlap import EVIDENCE_MIN, MapMatcher, cells_outside
from robrain.algorithms.slam.map_patch import pose_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame

logger = logging.getLogger(__name__)

ANSWERS_MIN = 3
"""Least number of agreeing answers before the robot joins a frame."""
ANSWERS_MAX = 12
"""Number of latest answers that are kept."""
BODY_M = 0.4
"""Radius of this robot as others may have drawn it."""
STRANGERS_MAX = 3
"""Number of robots that may be on the maps unknown: small things that are on one map only."""
UNSURE_M = 1.0
"""A robot whose place has at least this standard deviation takes its submaps out of the team's map."""
KNOWN_EVIDENCE_MIN = 2400
"""Least evidence for a place in a frame in which the robot has been before."""
EVIDENCE_SHARE = 0.4
"""On a small floor this share of the team's grid is enough: there are fewer places to be mistaken for."""
OUTSIDE_MAX = 50
"""Cells of its floor that may lie beyond the edge of the arena's map: half a square metre at 0.1 m."""
APART_M = 1.0
"""Least distance, metres, between two of the places from which agreeing answers were found."""
PLAIN_MIN = 250
"""Agreeing wall cells above which that distance is not needed if none contradicts: a robot may be at rest."""
AGREE_M, AGREE_RAD = 0.3, 0.05
"""Answers that put the robot within this distance and turn agree."""
JOIN_SIGMA_M, JOIN_SIGMA_RAD = 0.1, 0.02
"""Standard deviations of such an answer."""
FOLLOW_SIGMA_M, FOLLOW_SIGMA_RAD = 0.05, 0.01
"""Standard deviations of a teammate's movement as its followers adopt it."""


PRIOR_GATE = 16.27
"""99.9 % of a chi-square variable of three degrees of freedom."""


MayBeAt = Callable[[MapFrame, Pose2D], bool]


class FrameMove(NamedTuple):
    """From one map frame into another."""

    frame: MapFrame
    T_new_old: Pose2D


class _Answer(NamedTuple):
    T_new_old: Pose2D
    place: Pose2D
    """Searched from here, in the old frame."""


class Frames:
    """Keeps the map frame of one robot.

    Args:
        robot: whose frame it is.
        atlas: all submaps known to the robot.
        graph: the robot's own part of the pose graph.
        own: the submap that it is making.
        teammates_in: (K, 3) x, y, radius in metres of the teammates that publish their places in a map frame.
        teammates: number of all received teammates.

    """

    def __init__(
        self,
        robot: str,
        atlas: SubmapAtlas,
        graph: SubmapGraph,
        own: OwnSubmaps,
        teammates_in: Callable[[MapFrame], Floats],
        teammates: Callable[[], int],
    ) -> None:
        self.outgoing: list[MapPatch] = []
        """New poses of own submaps, to publish."""
        self._robot = robot
        self._atlas = atlas
        self._graph = graph
        self._own = own
        self._robot_places_in = teammates_in
        self._others = teammates
        self._answers: deque[tuple[MapFrame, _Answer]] = deque(maxlen=ANSWERS_MAX)
        self._turn = 0
        self._prior: tuple[Pose2D, Floats] | None = None
        """Pose and covariance (3, 3), arena frame, with which the robot has left that frame; None if it is lost."""

    @property
    def frame(self) -> MapFrame:
        """Frame in which the robot maps now."""
        return self._own.frame

    def begin(self, number: int, reason: str) -> None:
        """Begin a trajectory with this submap, in its own frame if there is a reason why the place is unknown."""
        self._prior = None
        self._enter(MapFrame(number, self._robot) if reason else ARENA, reason)

    def part(self, reason: str) -> None:
        """Move the submaps of this trajectory, which may lie wrong, from the team's map into their own frame."""
        numbers = [node.number for node in self._graph.own.values() if node.trajectory == self._own.trajectory]
        if not numbers:
            return
        frame = MapFrame(min(numbers), self._robot)
        current = self._graph.own[max(numbers)]
        self._prior = current.pose, current.covariance.copy()
        self._graph.part(self._own.trajectory, frame)
        self._enter(frame, reason)
        self._place({(self._robot, number): self._graph.own[number].T_arena_local for number in numbers})

    def uncertainty_reason(self) -> str:
        """Reason why the robot should leave the team's map: its place is too uncertain.

        Empty if its place is certain, or the robot is alone.
        """
        current = self._graph.current
        if current is None or self.frame != ARENA:
            return ""
        sigma_m = math.sqrt(max(current.covariance[0, 0], current.covariance[1, 1]))
        if sigma_m < UNSURE_M:
            return ""
        has_teammates = any(key[0] != self._robot and each.frame == ARENA for key, each in self._atlas.submaps.items())
        return f"its place is known to ± {sigma_m:.1f} m only" if has_teammates else ""

    def apply_fix(self, fix: ArenaFix) -> None:
        """Motes have localised the robot in the arena."""
        if self.frame != ARENA and fix.trajectory == self._own.trajectory:
            self._join(ARENA, fix.T_arena_frame, fix.at, fix.covariance)

    def move_of(self, patch: MapPatch) -> FrameMove | None:
        """Move of a teammate from the robot's frame into a better one by this patch; None if there is none.

        To be asked before the patch is taken into the atlas.
        """
        frame = self._own.frame
        if frame == ARENA:  # none is better
            return None
        for part in patch.parts or (patch,):
            known = self._atlas.submaps.get((part.robot, part.submap))
            if part.robot != patch.robot or part.withdrawn or known is None:
                continue
            if known.frame == frame and part.frame < frame:
                return FrameMove(part.frame, part.T_arena_local.compose(known.T_arena_local.inverse()))
        return None

    def follow(self, move: FrameMove) -> None:
        """Move as a teammate has."""
        current = self._graph.current
        here = Pose2D(0.0, 0.0, 0.0) if current is None else current.pose
        covariance = _covariance(FOLLOW_SIGMA_M, FOLLOW_SIGMA_RAD)
        self._join(move.frame, move.T_new_old, move.T_new_old.compose(here), covariance)

    def search(self, here: Pose2D, may_be_at: MayBeAt) -> None:
        """Search for the robot's map on that of a better frame, and move there if the result is certain.

        Args:
            here: where the robot is in its frame.
            may_be_at: whether other sensors allow the robot to be at a pose of a frame.

        """
        better = sorted({each.frame for each in self._atlas.submaps.values() if each.frame < self.frame})
        if not better:
            return
        self._turn += 1
        frame, turn = better[self._turn % len(better)], self._turn // len(better)
        own, other = self._atlas.grid, self._atlas.composed(frame)
        known, teammates = self._robot_places_in(self.frame), self._robot_places_in(frame)
        bodies = np.concatenate((self._own_bodies(here), known))
        # A robot that publishes no place in a map's frame may be drawn there as an obstacle.
        strangers = min(max(2 * self._others() - len(known) - len(teammates), 0), STRANGERS_MAX)
        evidence_min = KNOWN_EVIDENCE_MIN if self._was_in(frame) else EVIDENCE_MIN
        evidence_min = min(evidence_min, round(EVIDENCE_SHARE * other.geometry.width * other.geometry.height))
        was_at = [node.pose for node in self._graph.own.values() if node.frame == self.frame][:-1]
        is_past = turn % 4 == 3 and was_at  # where it is now may be new to the others
        if is_past or turn % 2 or not len(teammates):
            place = was_at[turn // 4 % len(was_at)] if is_past else here
            found = MapMatcher(own, other, bodies, teammates, strangers, evidence_min).find(place)
            T_new_old = None if found is None else found.T_other_own
        else:  # a teammate may have come to where this robot has been
            x_m, y_m, _ = teammates[turn // 2 % len(teammates)].tolist()
            at_teammate = Pose2D(x_m, y_m, 0.0)
            found = MapMatcher(other, own, teammates, bodies, strangers, evidence_min).find(at_teammate)
            T_new_old = None if found is None else found.T_other_own.inverse()
            place = here if found is None else found.T_other_own.compose(at_teammate)
        if found is None or T_new_old is None or not may_be_at(frame, T_new_old.compose(here)):
            return
        if frame == ARENA and cells_outside(own, T_new_old, other.geometry) > OUTSIDE_MAX:
            return
        if frame == ARENA and not self._agrees_with_prior(T_new_old):
            return
        self._answers.append((frame, _Answer(T_new_old, place)))
        is_plain = found.overlap.agreeing >= PLAIN_MIN and not found.overlap.contradicting
        if self._is_sure(frame, T_new_old, here, 0.0 if is_plain else APART_M):
            covariance = _covariance(JOIN_SIGMA_M, JOIN_SIGMA_RAD)
            self._join(frame, T_new_old, T_new_old.compose(place), covariance)

    def _agrees_with_prior(self, T_new_old: Pose2D) -> bool:
        """Whether the robot may lie so, by its estimate when it left the arena frame.

        Similar walls fit in several places. A robot that was only uncertain is in one near its estimate.
        """
        current = self._graph.current
        if self._prior is None or current is None:
            return True
        place, prior = self._prior
        here = current.pose
        at = T_new_old.compose(here)
        off = np.array((at.x_m - here.x_m, at.y_m - here.y_m, math.remainder(T_new_old.yaw_rad, math.tau)))
        away_m2 = float(prior[2, 2]) * place.distance_m(here) ** 2
        expected = prior + current.covariance + np.diag((away_m2, away_m2, 0.0))
        return bool(inverse_form(expected, off) < PRIOR_GATE)

    def _was_in(self, frame: MapFrame) -> bool:
        """Whether the robot has mapped in a frame before: so its place is most likely on that frame's map."""
        return any(key[0] == self._robot and each.frame == frame for key, each in self._atlas.submaps.items())

    def _is_sure(self, frame: MapFrame, T_new_old: Pose2D, here: Pose2D, least_apart_m: float) -> bool:
        """Whether enough answers, from places apart, agree with this one."""
        at = T_new_old.compose(here)
        agreeing = []
        for of_frame, answer in self._answers:
            other = answer.T_new_old.compose(here)
            turned_rad = abs(at.inverse().compose(other).yaw_rad)
            if of_frame == frame and other.distance_m(at) < AGREE_M and turned_rad < AGREE_RAD:
                agreeing.append(answer.place)
        apart_m = max(one.distance_m(other) for one in agreeing for other in agreeing)
        return len(agreeing) >= ANSWERS_MIN and apart_m >= least_apart_m

    def _own_bodies(self, here: Pose2D) -> Floats:
        """Places where others may have seen this robot without recognising it."""
        stayed = [here, *(node.pose for node in self._graph.own.values() if node.frame == self.frame)]
        return np.array([(at.x_m, at.y_m, BODY_M) for at in stayed])

    def _join(self, frame: MapFrame, T_new_old: Pose2D, at: Pose2D, covariance: Floats) -> None:
        before, reason = self.frame, self._own.reason
        self._graph.change_frame(before, frame, T_new_old, at, covariance)
        moved = [key for key, each in self._atlas.submaps.items() if key[0] == self._robot and each.frame == before]
        self._own.T_arena_local = T_new_old.compose(self._own.T_arena_local)
        self._enter(frame, "" if frame == ARENA else reason)
        self._place({key: T_new_old.compose(self._atlas.submaps[key].T_arena_local) for key in moved})

    def _enter(self, frame: MapFrame, reason: str) -> None:
        if frame != self.frame:
            logger.warning("%s: maps in %s", self._robot, _name(frame))
        self._own.frame, self._own.reason = frame, reason
        self._atlas.change_frame(frame)
        self._answers.clear()

    def _place(self, places: dict[SubmapKey, Pose2D]) -> None:
        self._atlas.move_all(places, self.frame)
        geometry = self._atlas.grid.geometry
        for key, place in places.items():
            self.outgoing.append(pose_message(self._robot, geometry, key[1], place, self.frame))


def _covariance(sigma_m: float, sigma_rad: float) -> Floats:
    return np.diag((sigma_m**2, sigma_m**2, sigma_rad**2))


def _name(frame: MapFrame) -> str:
    return "the arena frame" if frame == ARENA else f"a frame of {frame.robot}, begun with submap {frame.since}"
