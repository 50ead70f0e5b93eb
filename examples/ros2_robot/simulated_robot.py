"""A simulated robot on a map_server map: body, lidar and battery, in NumPy alone, without ROS.

Units are SI, angles radians; x forward, y left (REP 103).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

IDLE_A, DRIVE_A_PER_M_S, TURN_A_PER_RAD_S = 0.4, 1.5, 0.3
RESISTANCE_OHM = 0.13
CURVE_SOC = (0.0, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
CURVE_V = (10.6, 14.07, 14.7, 14.99, 15.2, 15.56, 16.07, 16.41)
"""Voltage at rest of four lithium-ion cells in series."""


@dataclass(frozen=True)
class Pose:
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True)
class Twist:
    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    yaw_rad_s: float = 0.0


class FloorMap:
    """A map of ROS' map_server: dark and unknown cells are solid.

    Args:
        path: of the YAML file; its image lies beside it.

    """

    def __init__(self, path: Path) -> None:
        spec = yaml.safe_load(path.read_text(encoding="utf-8"))
        grey = np.asarray(Image.open(path.parent / spec["image"]).convert("L"), dtype=np.float64) / 255.0
        darkness = grey if spec.get("negate", 0) else 1.0 - grey
        self.solid: NDArray[np.bool_] = np.flipud(darkness > float(spec.get("free_thresh", 0.196)))
        """(H, W); row 0 is the lowest."""
        self.resolution_m = float(spec["resolution"])
        self.origin_x_m, self.origin_y_m = map(float, spec["origin"][:2])

    def is_solid(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points lie in walls; the area beyond the map's edge is free."""
        column = np.floor((x_m - self.origin_x_m) / self.resolution_m).astype(np.int64)
        row = np.floor((y_m - self.origin_y_m) / self.resolution_m).astype(np.int64)
        height, width = self.solid.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return inside & self.solid[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]


class Lidar:
    """Ranges all around from the robot's centre, by steps of half a cell along each beam."""

    def __init__(self, floor: FloorMap, beams: int, range_max_m: float, noise_m: float) -> None:
        self.angles_rad = -math.pi + 2.0 * math.pi / beams * np.arange(beams)
        self.range_max_m, self._noise_m, self._floor = range_max_m, noise_m, floor
        step_m = 0.5 * floor.resolution_m
        self._reach_m = np.arange(step_m, range_max_m + step_m, step_m)

    def ranges_m(self, pose: Pose, rng: np.random.Generator) -> NDArray[np.float32]:
        """(N,), infinite for beams without a hit (REP 117)."""
        along_rad = pose.yaw_rad + self.angles_rad[:, np.newaxis]
        x_m, y_m = pose.x_m + self._reach_m * np.cos(along_rad), pose.y_m + self._reach_m * np.sin(along_rad)
        hit = self._floor.is_solid(x_m, y_m)
        ranges_m = self._reach_m[hit.argmax(axis=1)] + rng.normal(0.0, self._noise_m, hit.shape[0])
        return np.where(hit.any(axis=1), ranges_m, np.inf).astype(np.float32)


class Body:
    """A round robot on two driven wheels, or on mecanum wheels if `holonomic`; walls stop it.

    Args:
        floor: the map on which it drives.
        start: its pose on the map.
        slip: standard deviation of the odometry's error of each motion, as a share.

    """

    radius_m = 0.20
    speed_max_m_s, turn_max_rad_s = 0.8, 2.0
    acceleration_m_s2, turn_acceleration_rad_s2 = 1.5, 5.0
    watchdog_s = 0.5
    """Time for which a command is valid."""

    def __init__(self, floor: FloorMap, start: Pose, *, holonomic: bool, slip: float) -> None:
        self.pose, self.odometry = start, Pose(0.0, 0.0, 0.0)
        self.velocity = Twist()
        self._floor, self._holonomic, self._slip = floor, holonomic, slip
        self._wanted, self._commanded_s = Twist(), -math.inf
        edge_rad = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False)
        self._edge_m = self.radius_m * np.cos(edge_rad), self.radius_m * np.sin(edge_rad)
        if self._touches(start):
            raise ValueError(f"expected a start where the robot touches no wall, got {start}")

    def command(self, wanted: Twist, now_s: float) -> None:
        """Set the velocity; values that are not finite are ignored."""
        if all(map(math.isfinite, (wanted.forward_m_s, wanted.left_m_s, wanted.yaw_rad_s))):
            self._wanted, self._commanded_s = wanted, now_s

    def step(self, now_s: float, dt_s: float, rng: np.random.Generator) -> None:
        """Advance by `dt_s`."""
        wanted = self._wanted if now_s - self._commanded_s <= self.watchdog_s else Twist()
        now, reach_m_s = self.velocity, self.acceleration_m_s2 * dt_s
        self.velocity = Twist(
            _towards(now.forward_m_s, _within(wanted.forward_m_s, self.speed_max_m_s), reach_m_s),
            _towards(now.left_m_s, _within(wanted.left_m_s, self.speed_max_m_s) * self._holonomic, reach_m_s),
            _towards(
                now.yaw_rad_s, _within(wanted.yaw_rad_s, self.turn_max_rad_s), self.turn_acceleration_rad_s2 * dt_s
            ),
        )
        moved = _moved(self.pose, self.velocity, dt_s)
        if self._touches(moved):
            self.velocity = Twist(yaw_rad_s=self.velocity.yaw_rad_s)
            moved = _moved(self.pose, self.velocity, dt_s)
        self.pose = moved
        believed = 1.0 + self._slip * rng.normal(size=3)
        velocity = self.velocity
        seen = Twist(
            velocity.forward_m_s * believed[0], velocity.left_m_s * believed[1], velocity.yaw_rad_s * believed[2]
        )
        self.odometry = _moved(self.odometry, seen, dt_s)

    def _touches(self, pose: Pose) -> bool:
        return bool(self._floor.is_solid(pose.x_m + self._edge_m[0], pose.y_m + self._edge_m[1]).any())


class Battery:
    """Four lithium-ion cells in series, drained by the robot's motion."""

    capacity_c = 1.35 * 3600.0

    def __init__(self, soc: float) -> None:
        self.soc = soc
        self.current_a = IDLE_A
        """Positive while it is drained."""

    @property
    def voltage_v(self) -> float:
        """At the terminals."""
        return float(np.interp(self.soc, CURVE_SOC, CURVE_V)) - RESISTANCE_OHM * self.current_a

    def drain(self, velocity: Twist, dt_s: float) -> None:
        """Drive for `dt_s`."""
        speed_m_s = math.hypot(velocity.forward_m_s, velocity.left_m_s)
        self.current_a = IDLE_A + DRIVE_A_PER_M_S * speed_m_s + TURN_A_PER_RAD_S * abs(velocity.yaw_rad_s)
        self.soc = max(self.soc - self.current_a * dt_s / self.capacity_c, 0.0)


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _towards(now: float, wanted: float, reach: float) -> float:
    return now + _within(wanted - now, reach)


def _moved(pose: Pose, velocity: Twist, dt_s: float) -> Pose:
    yaw_rad = pose.yaw_rad + 0.5 * dt_s * velocity.yaw_rad_s
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return Pose(
        pose.x_m + dt_s * (cos * velocity.forward_m_s - sin * velocity.left_m_s),
        pose.y_m + dt_s * (sin * velocity.forward_m_s + cos * velocity.left_m_s),
        math.remainder(pose.yaw_rad + dt_s * velocity.yaw_rad_s, 2.0 * math.pi),
    )
