"""A lidar on a simulated robot: walls and other robots, all around."""

import math

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.ranges import NotNegative, Positive, PositiveInt, Share
from robrain.sim.firmware.lidar_line import LidarProtocol
from robrain.sim.maps.surfaces import FloorSurfaces

PLAIN = Mount()
NEAREST_OUTLIER_M = 0.05
"""Least range of an outlier."""


class LidarSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot.lidar]`: properties of a lidar. Raises ValueError for impossible values."""

    rays: PositiveInt = 180
    """Beams per turn, spread evenly over the full circle; the first points backwards (−π in the robot's frame)."""
    rate_hz: Positive = 5.0
    """Turns per second."""
    range_max_m: Positive = 6.0
    """Greatest measured range."""
    noise_m: NotNegative = 0.01
    """Standard deviation of a range."""
    dropout: Share = 0.0
    """Share of the beams, drawn at random, that return nothing: black or wet surfaces, or flat angles."""
    protocol: LidarProtocol = LidarProtocol.WIRE
    """Protocol of its output; the robot's file then has the plugin for that."""
    outlier: Share = 0.0
    """Share of the beams, drawn at random, with a random range: mixed pixels, stray reflections."""
    mount: Mount = Mount()
    """Its mount on the robot; its turns are in its own frame. The robot's file knows of it."""

    @property
    def is_imperfect(self) -> bool:
        """Whether a beam may return nothing although there is a wall, or lie beside where it was measured."""
        return bool(self.dropout) or self.protocol is not LidarProtocol.WIRE


class Lidar:
    """Turns the true world into scans.

    Args:
        spec: properties of the lidar.
        robot: whose it is.
        walls: (H, W) solid cells.
        geometry: placement of `walls` in the arena frame.
        rng: draws the noise, outliers and dropouts.
        surfaces: glass and mirrors among the walls; None if there are none.

    """

    def __init__(
        self,
        spec: LidarSpec,
        robot: str,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        rng: np.random.Generator,
        surfaces: FloorSurfaces | None = None,
    ) -> None:
        self.spec = spec
        self._robot = robot
        # A read-only array would be copied for every scan.
        self._walls = walls if walls.flags.writeable else walls.copy()
        self._geometry = geometry
        self._rng = rng
        self._surfaces = surfaces
        self._increment_rad = math.tau / spec.rays
        self.is_frozen = False
        """A frozen lidar keeps sending the previous turn, with new stamps, like a stuck driver or buffer."""
        self._last: Scan | None = None
        self._angles_rad = np.linspace(-math.pi, math.pi, spec.rays, endpoint=False)
        mount = spec.mount
        self._T_robot_sensor = None if mount == PLAIN else Pose2D(mount.x_m, mount.y_m, mount.yaw_rad)
        self._is_mirrored = mount.upside_down

    def scan(self, pose: Pose2D, robots: NDArray[np.float64]) -> Scan:
        """One turn from `pose`, arena frame.

        `robots` (K, 3) are the hulls of all robots, its own too: x, y, radius in metres, arena frame. A range that
        noise carries past the maximum range is no return.
        """
        if self.is_frozen and self._last is not None:
            return self._last
        spec = self.spec
        noisy_m = self.measure(pose, robots, self._angles_rad)
        ranges_mm = np.rint(1000.0 * noisy_m).astype(np.int64)
        ranges_mm[(ranges_mm < 1) & (noisy_m != 0.0)] = 1
        self._last = Scan(
            robot=self._robot,
            angle_min_rad=-math.pi,
            angle_increment_rad=self._increment_rad,
            range_max_m=spec.range_max_m,
            ranges_mm=ranges_mm.tolist(),
        )
        return self._last

    def measure(
        self, pose: Pose2D, robots: NDArray[np.float64], angles_rad: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Ranges (N,) in these directions (N,) of the sensor's frame, on a robot at `pose`; 0 if nothing came back."""
        spec = self.spec
        if self._T_robot_sensor is not None:
            pose = pose.compose(self._T_robot_sensor)
            angles_rad = -angles_rad if self._is_mirrored else angles_rad
        if self._surfaces is None:
            ranges_m = cast_rays_of(self._walls, self._geometry, pose, angles_rad, spec.range_max_m, robots)
        else:
            ranges_m = self._surfaces.cast(pose, angles_rad, spec.range_max_m, robots)
        noisy_m = ranges_m + spec.noise_m * self._rng.standard_normal(len(angles_rad))
        noisy_m[(ranges_m >= spec.range_max_m) | (noisy_m >= spec.range_max_m)] = 0.0
        if spec.outlier or spec.dropout:
            self._spoil(noisy_m)
        return noisy_m

    def _spoil(self, ranges_m: NDArray[np.float64]) -> None:
        """Apply outliers, then dropouts, in place; a range of 0 means no return."""
        spec, rays = self.spec, len(ranges_m)
        if spec.outlier:
            is_outlier = self._rng.random(rays) < spec.outlier
            anywhere_m = self._rng.uniform(NEAREST_OUTLIER_M, spec.range_max_m, rays)
            ranges_m[is_outlier] = anywhere_m[is_outlier]
        if spec.dropout:
            ranges_m[self._rng.random(rays) < spec.dropout] = 0.0
