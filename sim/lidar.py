"""A lidar at the centre of a simulated robot: walls and other robots, all around."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.occupancy_grid import GridGeometry
from robrain.protocol.model.ray_cast import cast_rays
from robrain.protocol.wire.messages import Scan


class LidarSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a lidar can do. Raises ValueError where it is built for values that are none."""

    rays: int = 180
    """Spread evenly over the full circle; the first looks backwards (−π in the robot's frame)."""
    rate_hz: float = 5.0
    range_max_m: float = 6.0
    noise_m: float = 0.01
    """Standard deviation of a range."""

    def __post_init__(self) -> None:
        for name in ("rays", "rate_hz", "range_max_m"):
            if not getattr(self, name) > 0:
                raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
        if not self.noise_m >= 0:
            raise ValueError(f"expected noise_m >= 0, got {self.noise_m}")


class Lidar:
    """Turns the true world into scans.

    Args:
        spec: what it can do.
        robot: whose it is.
        walls: (H, W) what is solid.
        geometry: where `walls` lies in the arena frame.
        rng: draws the noise, `rays` values a scan.

    """

    def __init__(
        self,
        spec: LidarSpec,
        robot: str,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        rng: np.random.Generator,
    ) -> None:
        self.spec = spec
        self._robot = robot
        # A read-only array would be copied for every scan.
        self._walls = walls if walls.flags.writeable else walls.copy()
        self._geometry = geometry
        self._rng = rng
        self._increment_rad = math.tau / spec.rays
        self.is_frozen = False
        """A frozen lidar goes on sending the turn before, with new stamps: what a stuck driver or buffer does."""
        self._last: Scan | None = None
        self._angles_rad = np.linspace(-math.pi, math.pi, spec.rays, endpoint=False)

    def scan(self, pose: Pose2D, robots: NDArray[np.float64]) -> Scan:
        """One turn from `pose`, arena frame.

        `robots` (K, 3) are the hulls of all robots, its own too: x, y, radius in metres, arena frame. What the noise
        carries past the maximum range is no return.
        """
        if self.is_frozen and self._last is not None:
            return self._last
        spec = self.spec
        ranges_m = cast_rays(self._walls, self._geometry, pose, self._angles_rad, spec.range_max_m, robots)
        noisy_m = ranges_m + spec.noise_m * self._rng.standard_normal(spec.rays)
        noisy_m[(ranges_m >= spec.range_max_m) | (noisy_m >= spec.range_max_m)] = 0.0
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
