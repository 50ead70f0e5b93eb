"""Loop closures of one robot: its scans matched against other submaps, and teammates' scans against its own."""

import math
from collections import deque
from collections.abc import Callable

from robrain.algorithms.mapping.local_map import Variances
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.numeric.small_linear_algebra import symmetric
from robrain.algorithms.slam.loop_closure import Contradiction, Lying, lay_on
from robrain.algorithms.slam.map_patch import is_near_grid
from robrain.algorithms.slam.submap_atlas import SUBMAPS_MAX, SubmapAtlas, SubmapKey
from robrain.algorithms.slam.submap_graph import SubmapGraph, is_information
from robrain.protocol.messages.maps.map_messages import Closure, Closures, MapPatch
from robrain.protocol.model.geometry import Pose2D

PATH_M = 0.4
"""Metres that the robot moves between two attempts."""
CONTRADICTS = 0.45
"""Share of agreeing beams below which a scan contradicts a submap."""
CONTRADICTIONS_MIN, SUBMAPS_MIN, ROBOTS_MIN = 6, 3, 2
"""Number of scans, of submaps and of robots that must contradict before the robot's place counts as wrong."""
CHECKS_MAX = 9
"""Number of recent scans that are counted. A scan counts if a teammate's submap agreed with it or any submap
contradicted it.

Measured in runs of 3 and 8 robots on four floors, wheels slipping: of 565 scans laid on teammates' submaps none did.
Agreement of the robot's own submaps is no evidence: those made since its error always agree.
"""
SLACK_ARM_M = 5.0
"""Distance of the walls, metres, that turns the slack in position into one in yaw."""
UNSAID: Variances = (4e-4, 4e-4, 1e-5)
"""Least variances of the pose of a teammate's submap, and those of one whose teammate has reported none."""
OTHER_SUBMAPS_MAX = 2 * SUBMAPS_MAX
"""Number of teammates' submaps whose variances are kept."""

OCCUPIED_MIN = 60
"""Least number of occupied cells of a submap: fewer do not determine a pose."""
TRIED_APART_M = 0.7
"""Metres that the robot moves before the same submap is tried again."""
TRIED_MAX = 4096
"""Number of submaps whose last attempt is remembered."""
INSIDE_M = 1.5
"""Least distance of the sensor from the edge of a submap's box, metres."""


class ClosureFinder:
    """Finds loop closures and adds them to the robot's part of the pose graph.

    Args:
        robot: name of this robot.
        graph: its part of the pose graph.
        atlas: all known submaps.
        slack_m: offsets up to this distance count as zero.

    """

    def __init__(self, robot: str, graph: SubmapGraph, atlas: SubmapAtlas, slack_m: float) -> None:
        self.closed = 0
        """Number of scans that matched another submap."""
        self.contradicted = 0
        """Number of scans that contradicted a submap that covers the place."""
        self.found: list[Closure] = []
        """Closures with teammates' submaps that are still to be published."""
        self._robot = robot
        self._graph = graph
        self._atlas = atlas
        self._slack_m = slack_m
        self._tried: dict[SubmapKey, Pose2D] = {}
        """Pose of the sensor when a submap was tried last, arena frame."""
        self._variances: dict[SubmapKey, Variances] = {}
        """Variances of the poses of teammates' submaps."""
        self._at: Pose2D | None = None
        self._checks: deque[SubmapKey | None] = deque(maxlen=CHECKS_MAX)
        """Submaps that contradicted a scan; None for those that agreed."""

    def restart(self) -> None:
        """The robot may be anywhere now: earlier results are no evidence."""
        self._tried.clear()
        self._checks.clear()

    def misplacement_reason(self) -> str:
        """Why the robot cannot be where it believes to be; empty while it may be.

        One teammate that is wrong contradicts all others, so submaps of two robots have to contradict this one.
        """
        contradicting = [key for key in self._checks if key is not None]
        submaps = set(contradicting)
        robots = {robot for robot, _ in submaps}
        if len(contradicting) < CONTRADICTIONS_MIN or len(submaps) < SUBMAPS_MIN or len(robots) < ROBOTS_MIN:
            return ""
        self._checks.clear()
        return f"{len(submaps)} submaps of {len(robots)} robots contradict what the lidar sees"

    def candidate(self, sensor: Pose2D) -> SubmapKey | None:
        """The submap to try next from this pose of the sensor, arena frame; None if there is none."""
        best, best_at = None, math.inf
        # The current submap and the one before: localisation matches scans against them already.
        recent = {(self._robot, number) for number in list(self._graph.own)[-2:]}
        for key, submap in self._atlas.submaps.items():
            if key in recent or submap.frame != self._atlas.frame:
                continue
            if submap.surfaces is None or submap.occupied < OCCUPIED_MIN:
                continue
            tried = self._tried.get(key)
            if tried is not None and tried.distance_m(sensor) < TRIED_APART_M:
                continue
            place = submap.T_arena_local.inverse().compose(sensor)
            if not self._is_inside(key, place):
                continue
            # Submaps that were never tried come first, then the one that was tried farthest from here.
            at = -math.inf if tried is None else -tried.distance_m(sensor)
            if at < best_at or best is None:
                best, best_at = key, at
        if best is not None:
            self._tried[best] = sensor
            if len(self._tried) > TRIED_MAX:
                del self._tried[next(iter(self._tried))]
        return best

    def check(
        self, number: int, local: Pose2D, sensor: Pose2D, points: Callable[[], Floats], covariance: tuple[float, ...]
    ) -> bool:
        """Match a scan against a submap that covers the place: one of another robot, or an old one of this robot.

        Args:
            number: number of the current submap.
            local: T_local_sensor.
            sensor: estimated T_arena_sensor.
            points: returns (K, 2) ends of the beams at walls, metres, sensor's frame; asked for only if needed.
            covariance: (3, 3) of the robot's pose, row-major, arena frame.

        Returns:
            Whether there was a submap to match it against.

        """
        if self._at is not None and self._at.distance_m(sensor) < PATH_M:
            return False
        key = self.candidate(sensor)
        if key is None:
            return False
        self._at = sensor
        submap = self._atlas.submaps[key]
        other = self.variances_of(key)
        sigma_m = math.sqrt(max(covariance[0] + other[0], covariance[4] + other[1]))
        sigma_rad = math.sqrt(covariance[8] + other[2])
        lying = lay_on(submap, self._atlas.grid.geometry, sensor, points(), sigma_m, sigma_rad)
        if isinstance(lying, Contradiction) and lying.agrees < CONTRADICTS:
            self.contradicted += 1
            self._checks.append(key)
        if not isinstance(lying, Lying):
            return True
        if key[0] != self._robot:
            self._checks.append(None)
        found = self._with_slack(submap.T_arena_local.inverse().compose(sensor), lying.sensor)
        at_own = local.compose(Pose2D(0.0, 0.0, -found.yaw_rad))
        at_other = Pose2D(found.x_m, found.y_m, 0.0)
        self._graph.close(number, at_own, key, at_other, lying.information)
        self.closed += 1
        if key[0] != self._robot:
            (xx, xy, xt), (_, yy, yt), (_, _, tt) = lying.information.tolist()
            upper = xx, xy, xt, yy, yt, tt
            closure = Closure(
                submap=number, at=at_own, other_robot=key[0], other_submap=key[1], at_other=at_other, information=upper
            )
            self.found.append(closure)
        return True

    def receive(self, message: Closures) -> str:
        """Add the closures that a teammate has found with submaps of this robot.

        Returns:
            Why some were refused; empty if none was.

        """
        reason = ""
        for closure in message.closures:
            if closure.other_robot != self._robot:
                continue
            information = symmetric(closure.information)
            if not is_information(information):
                reason = f"{message.robot}: the information of a loop closure is no inverse covariance"
            elif not (self._is_near(closure.at) and self._is_near(closure.at_other)):
                reason = f"{message.robot}: a loop closure lies far outside the map"
            else:
                other = message.robot, closure.submap
                self._graph.add_robot_closure(closure.other_submap, closure.at_other, other, closure.at, information)
        return reason

    def receive_submap_poses(self, patch: MapPatch) -> None:
        """Record the poses of a teammate's submaps and their variances."""
        moved = False
        for part in patch.parts or (patch,):
            if part.robot != patch.robot or part.withdrawn:
                continue
            key = part.robot, part.submap
            if len(self._variances) >= OTHER_SUBMAPS_MAX and key not in self._variances:
                # A teammate may report submaps that do not exist: drop the variances of submaps without cells.
                self._variances = {
                    each: reported for each, reported in self._variances.items() if each in self._atlas.submaps
                }
            is_reported = part.variance_m2 > 0.0 or part.variance_rad2 > 0.0
            if is_reported and (len(self._variances) < OTHER_SUBMAPS_MAX or key in self._variances):
                floor_m2, _, floor_rad2 = UNSAID
                variance_m2, variance_rad2 = max(part.variance_m2, floor_m2), max(part.variance_rad2, floor_rad2)
                self._variances[key] = variance_m2, variance_m2, variance_rad2
            moved = moved or not part.cells
        if moved and self._graph.rests_on(patch.robot):
            self._graph.has_news = True

    def variances_of(self, key: SubmapKey) -> Variances:
        """Variances of the pose of a submap."""
        own = self._graph.own.get(key[1]) if key[0] == self._robot else None
        if own is not None:
            x_m2, y_m2, yaw_rad2 = own.covariance.diagonal().tolist()
            return x_m2, y_m2, yaw_rad2
        return self._variances.get(key, UNSAID)

    def _is_inside(self, key: SubmapKey, place: Pose2D) -> bool:
        submap, geometry = self._atlas.submaps[key], self._atlas.grid.geometry
        inside = INSIDE_M / geometry.resolution_m
        row, column = geometry.cell_of(place.x_m, place.y_m)
        height, width = submap.evidence.shape
        at_row, at_column = row - submap.row, column - submap.column
        return bool(inside <= at_row <= height - inside and inside <= at_column <= width - inside)

    def _is_near(self, place: Pose2D) -> bool:
        """Whether a pose in a submap's frame is in or near the team's grid, as the cells of submaps are."""
        geometry = self._atlas.grid.geometry
        return is_near_grid(geometry, *geometry.cell_of(place.x_m, place.y_m))

    def _with_slack(self, believed: Pose2D, found: Pose2D) -> Pose2D:
        slack_m = self._slack_m
        if not slack_m:
            return found
        turned_rad = math.remainder(found.yaw_rad - believed.yaw_rad, math.tau)
        off_m, slack_rad = believed.distance_m(found), slack_m / SLACK_ARM_M
        share = max(off_m - slack_m, 0.0) / max(off_m, slack_m)
        turn_share = max(abs(turned_rad) - slack_rad, 0.0) / max(abs(turned_rad), slack_rad)
        return Pose2D(
            believed.x_m + share * (found.x_m - believed.x_m),
            believed.y_m + share * (found.y_m - believed.y_m),
            believed.yaw_rad + turn_share * turned_rad,
        )
