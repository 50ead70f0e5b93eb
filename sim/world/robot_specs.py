"""Robots of a scenario that differ from each other: `[[robots]]`."""

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from robrain.agent.host.agent_host import stock_place
from robrain.agent.lifecycle.plugin_folders import PluginFolders
from robrain.agent.manifest import read_manifest
from robrain.protocol.file_mistakes import unknown_name
from robrain.protocol.model.checked import convert
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.maps.floor_plan import FloorPlan, PlacementError
from robrain.sim.maps.placement import Starts, scatter_poses, spawn_poses
from robrain.sim.robot.robot_hardware import RobotHardware

ROBOT_SPACING_M = 0.7
LIDAR_PLUGIN, BASE_PLUGIN, IMU_PLUGIN = "scan", "mocdevice", "imu"
"""Their names also where other plugins replace them."""


class RobotType(StrEnum):
    """Construction of a robot; its `hardware` and `plugins` change single values."""

    OMNI = "omni"
    """The values of the table `[robot]`."""
    SCOUT = "scout"
    """Small, with a small battery and a lidar that sees 4 m."""
    CARRIER = "carrier"
    """Large and slow, with a large battery."""
    TWO_WHEELS = "two_wheels"
    """A differential base, whose motor controller has other frames (`protocol/can/two_wheels.dbc`)."""
    SERIAL = "serial"
    """The same wheels, whose motor controller speaks lines of text on a serial line."""
    FOUR_OMNI = "four_omni"
    """Four omni wheels (`protocol/can/four_wheels.dbc`)."""
    MECANUM = "mecanum"
    """Four mecanum wheels, with the same frames."""
    CAR = "car"
    """Front wheels that steer (`protocol/can/car.dbc`)."""


WHEELS = {"wheel_radius_m": 0.05, "encoder_ticks_per_turn": 4096}
HARDWARE: Mapping[RobotType, dict[str, Any]] = MappingProxyType(
    {
        RobotType.OMNI: {},
        RobotType.SCOUT: {
            "radius_m": 0.15,
            "base": {"wheel_distance_m": 0.115},
            "battery": {"capacity_wh": 12.0},
            "lidar": {"range_max_m": 4.0},
        },
        RobotType.CARRIER: {
            "radius_m": 0.28,
            "base": {"wheel_distance_m": 0.22, "wheel_radius_m": 0.05},
            "battery": {"capacity_wh": 90.0},
        },
        RobotType.TWO_WHEELS: {
            "chassis": {"type": "differential", "track_m": 0.3, **WHEELS},
        },
        RobotType.SERIAL: {
            "chassis": {"type": "differential", "track_m": 0.3, **WHEELS},
            "controller": "lines",
        },
        RobotType.FOUR_OMNI: {
            "chassis": {"type": "omni", "wheel_distance_m": 0.16, "wheel_angles_deg": [45, 135, 225, 315], **WHEELS},
        },
        RobotType.MECANUM: {
            "chassis": {"type": "mecanum", "wheelbase_m": 0.22, "track_m": 0.26, **WHEELS},
        },
        RobotType.CAR: {
            "chassis": {"type": "ackermann", "wheelbase_m": 0.2, "track_m": 0.24, "steering_max_rad": 0.6, **WHEELS},
        },
    }
)
"""Values of `[robot]` that a type changes. All values are chosen."""
PLUGINS: Mapping[RobotType, dict[str, dict[str, Any]]] = MappingProxyType(
    {RobotType.CARRIER: {"driver": {"speed_m_s": 0.4, "acceleration_m_s2": 0.5, "turn_rate_rad_s": 1.0}}}
)
"""Parameters of plugins that a type changes."""


class RobotSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[robots]]`: one robot, `r1` the first; further robots of the team have the values of `[robot]`.

    Raises ValueError for hardware that there is not, and for values without sense.
    """

    type: RobotType = RobotType.OMNI
    place_m: tuple[float, float] | None = None
    """Its start; where `[team]` puts it if absent."""
    yaw_rad: float | None = None
    """With `place_m`: its heading at the start; 0 if absent."""
    near_m: tuple[float, float] | None = None
    """It starts as near to this point as there is room, instead of at a `place_m`."""
    without: tuple[str, ...] = ()
    """Plugins that it lacks, such as `camera`; plugins that require them are omitted as well."""
    hardware: dict[str, Any] = {}
    """Keys of `[robot]` that are different for it, such as `radius_m` or `lidar = { rays = 90 }`."""
    plugins: dict[str, dict[str, Any]] = {}
    """Parameters of its plugins by their names, over those of the manifests."""

    def __post_init__(self) -> None:
        for name in ("place_m", "near_m"):
            value = getattr(self, name)
            if value is not None and not all(map(math.isfinite, value)):
                raise ValueError(f"expected a finite {name}, got {list(value)}")
        if self.place_m is not None and self.near_m is not None:
            raise ValueError("expected either place_m or near_m, got both")
        if self.yaw_rad is not None and (self.place_m is None or not math.isfinite(self.yaw_rad)):
            raise ValueError("expected a finite yaw_rad, and only with place_m")
        self.built(RobotHardware())
        known = {*_requirements(), IMU_PLUGIN}
        for name in (*self.without, *self.plugins):
            if name not in known:
                raise ValueError(f"no plugin {name}; there are {', '.join(sorted(known))}")

    def built(self, team: RobotHardware) -> RobotHardware:
        """Its hardware.

        Args:
            team: values of `[robot]`.

        Raises:
            ValueError: naming the wrong key of `hardware`.

        """
        raw: dict[str, Any] = msgspec.to_builtins(team)
        try:
            return convert(merged(merged(raw, HARDWARE[self.type]), self.hardware), RobotHardware)
        except msgspec.ValidationError as error:
            if unknown := unknown_name(self.hardware, RobotHardware, "hardware"):
                raise ValueError(unknown) from error
            what, _, key = str(error).partition(" - at `$.")
            raise ValueError(f"hardware{'.' if key else ''}{key.rstrip('`')}: {what}") from error

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of its plugins."""
        return merged(PLUGINS.get(self.type, {}), self.plugins)

    @property
    def load(self) -> list[str] | None:
        """The plugins that it has, sorted; None for all."""
        return with_all(self.without) if self.without else None


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """One table over another, within nested tables too.

    >>> merged({"a": 1, "b": {"c": 2, "d": 3}}, {"b": {"d": 4}})
    {'a': 1, 'b': {'c': 2, 'd': 4}}
    """
    found = dict(under)
    for key, value in over.items():
        below = found.get(key)
        found[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return found


def with_all(without: Iterable[str], *, free: Iterable[str] = ()) -> list[str]:
    """The stock plugins without these and without plugins that require them, directly or indirectly; sorted.

    Args:
        without: plugins that are missing.
        free: plugins that others replace, which require nothing.

    """
    known, missing = _requirements() | {name: set[str]() for name in free}, set(without)
    while more := {name for name, requires in known.items() if name not in missing and missing & requires}:
        missing |= more
    return sorted(known.keys() - missing)


def start_poses(
    plan: FloorPlan,
    specs: Sequence[RobotSpec],
    radii_m: Sequence[float],
    near: Point2D | None,
    starts: Starts,
    rng: np.random.Generator,
) -> list[Pose2D]:
    """Start of each robot of a team, arena frame: those with a place, then those near one, then the others.

    Args:
        plan: the floor.
        specs: of the first robots.
        radii_m: of all robots.
        near: common start of the others; the place with most room if None.
        starts: placement of the others.
        rng: draws places and headings.

    Raises:
        PlacementError: there is no room for one.

    """
    given = [*specs, *(RobotSpec() for _ in range(len(radii_m) - len(specs)))][: len(radii_m)]
    poses: dict[int, Pose2D] = {}
    for index, spec in enumerate(given):
        if spec.place_m is not None:
            poses[index] = Pose2D(*spec.place_m, spec.yaw_rad or 0.0)
    for index, spec in enumerate(given):
        if spec.near_m is not None:
            room = _around(plan, poses, radii_m)
            (poses[index],) = spawn_poses(
                room, 1, radii_m[index], near=Point2D(*spec.near_m), rng=rng, spacing_m=ROBOT_SPACING_M
            )
    left = [index for index in range(len(given)) if index not in poses]
    if left:
        room, radius_m = _around(plan, poses, radii_m), max(radii_m[index] for index in left)
        if starts is Starts.SCATTERED:
            drawn = scatter_poses(room, len(left), radius_m, rng=rng, spacing_m=ROBOT_SPACING_M)
        else:
            drawn = spawn_poses(room, len(left), radius_m, near=near, rng=rng, spacing_m=ROBOT_SPACING_M)
        poses |= dict(zip(left, drawn, strict=True))
    return [poses[index] for index in range(len(given))]


def check_places(plan: FloorPlan, specs: Sequence[RobotSpec], radii_m: Sequence[float]) -> None:
    """Raise PlacementError if a robot's own place is too near to a wall or to another's."""
    placed = [
        (index, Point2D(*spec.place_m), radius_m)
        for index, (spec, radius_m) in enumerate(zip(specs, radii_m, strict=False))
        if spec.place_m is not None
    ]
    for index, place, radius_m in placed:
        room_m = plan.clearance_at(place.x_m, place.y_m)
        others = [other for other in placed if other[0] < index]
        near = next((other for other in others if place.distance_m(other[1]) < radius_m + other[2]), None)
        if room_m < radius_m or near is not None:
            what = f"{room_m:.2f} m to the next wall" if near is None else f"r{near[0] + 1} there"
            raise PlacementError(
                f"expected room for r{index + 1}, of radius {radius_m:g} m, at x {place.x_m:g}, y {place.y_m:g} on "
                f"{plan.name}, got {what}; move it in [[robots]]"
            )


def _around(plan: FloorPlan, poses: Mapping[int, Pose2D], radii_m: Sequence[float]) -> FloorPlan:
    """The floor with the robots that are there already as walls."""
    if not poses:
        return plan
    rows, columns = plan.occupied.shape
    x_m = plan.origin_x_m + (np.arange(columns) + 0.5) * plan.resolution_m
    y_m = (plan.origin_y_m + (np.arange(rows) + 0.5) * plan.resolution_m)[:, np.newaxis]
    occupied = plan.occupied.copy()
    for index, pose in poses.items():
        reach_m = max(radii_m[index], ROBOT_SPACING_M / 2)
        occupied |= (x_m - pose.x_m) ** 2 + (y_m - pose.y_m) ** 2 < reach_m**2
    return FloorPlan(occupied, plan.resolution_m, plan.origin_x_m, plan.origin_y_m, plan.name)


@cache
def _requirements() -> dict[str, set[str]]:
    """The stock plugins, and the requirements of each; they do not change while the process runs."""
    found = PluginFolders([stock_place()]).find()
    return {name: set(read_manifest(path).tag.requires) for name, path in found.items()}
