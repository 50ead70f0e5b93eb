"""A world: a scenario's floor with its robots and motes in their places, for one seed."""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import msgspec
import numpy as np
import yaml
from PIL import Image

from robrain.agent.host.agent_host import stock_place
from robrain.agent.host.robot_file import RobotFile, RobotTable, ZenohTable
from robrain.agent.lifecycle.plugin_folders import PluginFolders
from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.algorithms.slam.floor_map import FloorMap
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.serial.serial_line import SIMULATED
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.provenance import MAP_ATTACHMENT
from robrain.sim.errors import ScenarioError
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.firmware.described_controller import BASE_LINE, CYCLES_PER_S, frames_of
from robrain.sim.firmware.disturbance import DisturbanceSpec
from robrain.sim.firmware.lidar_line import LINE, LidarProtocol
from robrain.sim.firmware.wit_imu import IMU_LINE
from robrain.sim.maps.floor_plan import FloorPlan, PlacementError
from robrain.sim.maps.placement import Starts, scatter_points
from robrain.sim.maps.surfaces import SurfaceSpec
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.motes.motes import SensorNetwork
from robrain.sim.points.point_team import HARDWARE_PLUGINS, PLACE, POINT_TICK_S, ROLES
from robrain.sim.robot.robot_hardware import ArenaRobot, Controller, RobotHardware
from robrain.sim.traffic.traffic import TrafficPlan
from robrain.sim.world import robot_specs
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.link_spec import LinkSpec
from robrain.sim.world.referee import team_geometry
from robrain.sim.world.robot_specs import IMU_PLUGIN, RobotSpec, check_places, merged, start_poses, with_all
from robrain.sim.world.scenario_tasks import TaskSpec

TICK_S = 0.02
MOTE_CLEARANCE_M = 0.1
EXACT_NOISE = {"sigma_m_per_sqrt_m": 2e-4, "sigma_rad_per_sqrt_m": 1e-5, "sigma_rad_per_sqrt_rad": 3e-5}
EXACT_ERRORS = {"scale": 1e-5, "curve_rad_per_m": 2e-6, "turn": 1e-5}
EXACT_START = {"start_sigma_m": 0.001, "start_sigma_rad": 0.0001}
"""Errors of odometry and start of a base whose wheels equal its file: measured in open halls (`tests/sim`)."""


class Fidelity(StrEnum):
    """Level of detail of simulated robots."""

    FULL = "full"
    """Bodies, firmware, buses and sensors."""
    POINTS = "points"
    """Points with exact poses on the floor, and batteries that follow the energy model; fast."""


@dataclass(frozen=True)
class World:
    """Everything that is put into an arena."""

    plan: FloorPlan
    robots: list[ArenaRobot]
    motes: list[ArenaMote]
    seed: int
    network: SensorNetwork = SensorNetwork()  # noqa: RUF009 - immutable, so a shared default is safe
    """Specification of the motes, their radio and the field that they sense."""
    chargers: tuple[ChargerSpec, ...] = ()
    faults: tuple[FaultSpec, ...] = ()
    surfaces: SurfaceSpec = SurfaceSpec()  # noqa: RUF009 - immutable, so a shared default is safe
    """Glass and mirrors among the walls."""
    disturbance: DisturbanceSpec = DisturbanceSpec()  # noqa: RUF009 - immutable, so a shared default is safe
    """Late frames and scans, paused agents."""
    starts_known: bool = True
    """Whether robots know their start poses; if not, only the first robot does, or none on a known floor."""
    idle: bool = False
    """Whether robots without a coordinator explore only if a task requests it."""
    tasks: tuple[TaskSpec, ...] = ()
    """Tasks that the scenario requests of the team."""
    traffic: TrafficPlan | None = None
    """Doors, moving obstacles and people; None if there are none."""
    links: LinkSpec | None = None
    """Links between members; None if every component receives all messages."""
    fidelity: Fidelity = Fidelity.FULL
    floor: FloorMap | None = None
    """The floor as the team knows it before the run; None if it has to explore."""
    added: "tuple[AddedTable, ...]" = ()
    """Tables of other distributions."""

    def check_live(self) -> None:
        """Raise ScenarioError for robots that are simulated only in lockstep."""
        if self.fidelity is not Fidelity.FULL:
            raise ScenarioError(f'{self.plan.name}: fidelity: expected "full" in live, got "{self.fidelity}"')

    @property
    def tick_s(self) -> float:
        """Duration of a tick."""
        return POINT_TICK_S if self.fidelity is Fidelity.POINTS else TICK_S

    def arena_rng(self) -> np.random.Generator:
        """The randomness of the arena."""
        return np.random.default_rng([self.seed, 1])

    def robot_file(
        self, robot: ArenaRobot, *, team: str = DEFAULT_TEAM, connect: tuple[str, ...] = (), is_restart: bool = False
    ) -> RobotFile:
        """Configuration of a robot's agent for this world: its start, and the grid to map on.

        An agent that is restarted during the run does not know its robot's pose.
        """
        geometry = team_geometry(self.plan)
        is_given = self.starts_known or (robot is self.robots[0] and self.floor is None)
        start, is_known = robot.start, is_given and not is_restart
        if not is_known:
            width_m, height_m = self.plan.size_m
            start = Pose2D(self.plan.origin_x_m + 0.5 * width_m, self.plan.origin_y_m + 0.5 * height_m, 0.0)
        # An exact odometry is better than cells of 0.1 m can resolve; late frames and pauses make any odometry inexact.
        slack_cells = 0.5 if robot.wheels.is_exact and not self.disturbance.is_on else 0.0
        is_exact = bool(slack_cells) and robot.imu is None
        of_world: dict[str, dict[str, Any]] = {
            "localisation": {
                "x_m": start.x_m,
                "y_m": start.y_m,
                "yaw_rad": start.yaw_rad,
                **({} if is_known else {"start_known": False}),
                "wall_slack_cells": slack_cells,
                **(EXACT_START if is_known and is_exact else {}),
                **({"errors": EXACT_ERRORS} if is_exact else {}),
            },
            **({"driver": {"odometry": EXACT_NOISE}} if is_exact else {}),
            "mapper": {
                "resolution_m": geometry.resolution_m,
                "origin_x_m": geometry.origin_x_m,
                "origin_y_m": geometry.origin_y_m,
                "width_m": geometry.width * geometry.resolution_m,
                "height_m": geometry.height * geometry.resolution_m,
                "closure_slack_m": slack_cells * geometry.resolution_m,
                **({} if robot.lidar.is_imperfect else {"submap": {"misses_min": 1}}),
            },
            "battery": {"capacity_wh": robot.battery.capacity_wh},
            "mocdevice": {"radius_m": robot.radius_m, **_base(robot, self.disturbance)},
            **_lidar(robot),
            **_range_sensors(robot),
            **_imu(robot),
            **_home(self.chargers),
            "obstacle_distance": {"radius_m": robot.radius_m},
            **_gateway(self.network, robot.name),
            **({"explore": {"exploration": NO_EXPLORATION}} if self.idle else {}),
            **(self.links.idle_parameters(start) if self.links is not None and is_known and not connect else {}),
        }
        load = None if robot.load is None else [*robot.load, *([IMU_PLUGIN] if robot.imu is not None else [])]
        parameters, roles, places = merged(of_world, robot.plugins), _roles(robot), list[str]()
        if self.fidelity is Fidelity.POINTS:
            load, roles, places = point_load(load, has_motes=bool(self.motes)), ROLES, [str(PLACE)]
            parameters = {name: values for name, values in parameters.items() if name in load}
        return RobotFile(
            robot=RobotTable(robot.name, team, places=places, load=load, roles=roles, consensus=robot.consensus),
            zenoh=ZenohTable(connect=list(connect)),
            parameters=parameters,
        )

    def first_place(self) -> Point2D | None:
        """A place, in half metres, for a first task: the first robot sees it from its start and drives straight to it.

        Of the places 1.5 to 3.5 m away, the one with the most room; None if there is none.
        """
        robot = self.robots[0]
        found: tuple[float, Point2D | None] = (0.0, None)
        x_m, y_m = robot.start.x_m, robot.start.y_m
        for column in range(math.ceil(2 * x_m) - 7, math.floor(2 * x_m) + 8):
            for row in range(math.ceil(2 * y_m) - 7, math.floor(2 * y_m) + 8):
                place = Point2D(column / 2, row / 2)
                away_m = robot.start.distance_m(place)
                if not 1.5 <= away_m <= 3.5:
                    continue
                shares = np.linspace(0.0, 1.0, 36)
                line = [(x_m + share * (place.x_m - x_m), y_m + share * (place.y_m - y_m)) for share in shares]
                if all(self.plan.contains_free(*at) for at in line):
                    room_m = [float(self.plan.clearance_m[self.plan.geometry.cell_of(*at)]) for at in line]
                    if min(room_m) > robot.radius_m + 0.1 and room_m[-1] > found[0]:
                        found = room_m[-1], place
        return found[1]

    def map_yaml(self) -> str:
        """Scale and origin of `map_png`, in the map_server format."""
        plan = self.plan
        origin = [plan.origin_x_m, plan.origin_y_m, 0.0]
        cells = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25}
        return yaml.safe_dump({"image": MAP_ATTACHMENT, "resolution": plan.resolution_m, "origin": origin, **cells})

    def map_png(self) -> bytes:
        """The true floor as a picture: north up, walls black."""
        picture = Image.fromarray(np.where(self.plan.occupied, 0, 254).astype(np.uint8)[::-1])
        buffer = io.BytesIO()
        picture.save(buffer, format="PNG")
        return buffer.getvalue()


class AddedTable(Checked, frozen=True, forbid_unknown_fields=True):
    """A scenario's table of another distribution; its entry point in `robrain.scenario_tables` has its name."""

    def build(self, world: World, wire: Endpoint) -> Callable[[int], None]:
        """Add its content to an arena, before the first tick.

        Args:
            world: the floor with robots and motes.
            wire: the arena's endpoint.

        Returns:
            A function that each tick calls with the simulated time in ns.

        """
        raise NotImplementedError


def point_load(load: Sequence[str] | None, *, has_motes: bool) -> list[str]:
    """Plugins of a robot that is a point: those that need no hardware that points lack.

    Args:
        load: the plugins that it would have with hardware; all stock ones if None.
        has_motes: whether there are motes; a base station that has none to talk to would only cost time.

    """
    able = with_all(HARDWARE_PLUGINS if has_motes else (*HARDWARE_PLUGINS, "mote_base"), free=ROLES)
    return able if load is None else [name for name in able if name in load]


def build_world(
    plan: FloorPlan,
    robots: int,
    motes: int,
    near: Point2D | None,
    seed: int,
    hardware: RobotHardware = RobotHardware(),  # noqa: B008 - immutable, so a shared default is safe
    network: SensorNetwork = SensorNetwork(),  # noqa: B008 - immutable, so a shared default is safe
    chargers: Sequence[ChargerSpec] = (),
    starts: Starts = Starts.TOGETHER,
    mote_places: Sequence[tuple[float, float]] = (),
    specs: Sequence[RobotSpec] = (),
) -> World:
    """Put robots and motes on a floor.

    `near` counts for robots that start together, `mote_places` for the first motes, `specs` for the first robots.

    Raises:
        PlacementError: they do not fit.

    """
    rng = np.random.default_rng([seed, 0])
    built = [spec.built(hardware) for spec in specs[:robots]] + [hardware] * (robots - len(specs))
    radii_m = [each.radius_m for each in built]
    check_places(plan, specs[:robots], radii_m)
    poses = start_poses(plan, specs[:robots], radii_m, near, starts, rng)
    arena_robots = [
        ArenaRobot(name=f"r{number}", start=pose, **(msgspec.structs.asdict(each) | _software(specs, number)))
        for number, (pose, each) in enumerate(zip(poses, built, strict=True), 1)
    ]
    reachable = plan.reachable([Point2D(pose.x_m, pose.y_m) for pose in poses], min(radii_m))
    for charger in chargers:
        _check_charger(charger, plan, hardware.radius_m)
    places = [_mote_place(plan, place) for place in mote_places[:motes]]
    if drawn := motes - len(places):
        area_m2 = float(reachable.sum()) * plan.resolution_m**2
        spacing_m = 0.7 * math.sqrt(area_m2 / drawn)
        places += scatter_points(plan, drawn, reachable, rng=rng, min_clearance_m=MOTE_CLEARANCE_M, spacing_m=spacing_m)
    arena_motes = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in enumerate(places, 1)]
    return World(plan, arena_robots, arena_motes, seed, network, tuple(chargers))


def _software(specs: Sequence[RobotSpec], number: int) -> dict[str, Any]:
    """Plugins of a robot, as fields of `ArenaRobot`; empty for a robot like the others."""
    if number > len(specs):
        return {}
    spec = specs[number - 1]
    load = spec.load
    has_lidar = load is None or robot_specs.LIDAR_PLUGIN in load
    return {"load": None if load is None else tuple(load), "plugins": spec.parameters, "has_lidar": has_lidar}


def _mote_place(plan: FloorPlan, place_m: tuple[float, float]) -> Point2D:
    if not plan.contains_free(*place_m):
        x_m, y_m = place_m
        raise PlacementError(
            f"expected free floor of {plan.name} for the mote at x {x_m:g}, y {y_m:g}; move it in [motes] places_m"
        )
    return Point2D(*place_m)


def _check_charger(charger: ChargerSpec, plan: FloorPlan, radius_m: float) -> None:
    clearance_m = plan.clearance_at(*charger.place_m)
    if clearance_m < radius_m:
        x_m, y_m = charger.place_m
        raise PlacementError(
            f"expected room for a robot of radius {radius_m:g} m at the charger at x {x_m:g}, y {y_m:g} on "
            f"{plan.name}, got {clearance_m:.2f} m to the next wall; move it in [[chargers]]"
        )


def _stamped_at(disturbance: DisturbanceSpec) -> dict[str, object]:
    """Parameter of `mocdevice` about the stamps of late frames; none if no frames are late."""
    return {"stamped_at": disturbance.can.stamped_at.value} if disturbance.can.is_on else {}


def _home(chargers: Sequence[ChargerSpec]) -> dict[str, dict[str, object]]:
    """Configuration of the docks for the agent; empty if there are none."""
    places = []
    for charger in chargers:
        place = dict(zip(("x_m", "y_m"), charger.place_m, strict=True))
        places.append(place if charger.yaw_rad is None else place | {"yaw_rad": charger.yaw_rad})
    return {"home": {"chargers": places}} if places else {}


def _gateway(network: SensorNetwork, robot: str) -> dict[str, dict[str, object]]:
    """Configuration of a gateway's agent; empty if the robot is no gateway."""
    motes = network.motes
    return {"snw_exploration": {"store_readings": motes.gateway_readings}} if robot in motes.gateways else {}


def _imu(robot: ArenaRobot) -> dict[str, dict[str, object]]:
    """Parameters of the inertial measurement unit; nothing of one that is not there."""
    imu = robot.imu
    if imu is None:
        return {}
    mounting = {"upside_down": True} if imu.upside_down else {}
    return {IMU_PLUGIN: {"port": f"{SIMULATED}{IMU_LINE}", "rate_hz": imu.rate_hz, **mounting}}


def _range_sensors(robot: ArenaRobot) -> dict[str, dict[str, object]]:
    """Configuration of the range sensors for the agent; empty if there are none."""
    ring = robot.range_sensors
    if not ring.angles_rad:
        return {}
    return {
        "range_sensors": {
            "angles_rad": list(ring.angles_rad),
            "range_max_m": ring.range_max_m,
            "mounted_m": robot.radius_m,
        }
    }


def _base(robot: ArenaRobot, disturbance: DisturbanceSpec) -> dict[str, Any]:
    """Parameters of the base: the wheels, and the frames or lines if they are not the Robertino's."""
    stamped = _stamped_at(disturbance)
    if robot.chassis is None:
        return {"base": msgspec.to_builtins(robot.base), **stamped}
    base: dict[str, Any] = {"base": msgspec.to_builtins(robot.chassis)}
    if robot.controller is Controller.LINES:
        lines = {"units": ["turns/s"], "scale": robot.chassis.encoder_ticks_per_turn / CYCLES_PER_S}
        return {**base, "port": f"{SIMULATED}{BASE_LINE}", "lines": lines}
    return {**base, "frames": msgspec.to_builtins(frames_of(robot.chassis)), **stamped}


def _roles(robot: ArenaRobot) -> dict[str, str]:
    protocol = robot.lidar.protocol
    roles = {} if protocol is LidarProtocol.WIRE else {robot_specs.LIDAR_PLUGIN: protocol.value}
    if robot.imu is not None:
        roles[IMU_PLUGIN] = "serial_imu"
    return roles if robot.controller is Controller.CAN else {**roles, robot_specs.BASE_PLUGIN: "serial_base"}


def _lidar(robot: ArenaRobot) -> dict[str, dict[str, Any]]:
    """Parameters of a lidar on a serial line, or of one that is not at the robot's centre."""
    lidar = robot.lidar
    mount = {} if lidar.mount == Mount() else {"mount": msgspec.to_builtins(lidar.mount)}
    if lidar.protocol is not LidarProtocol.WIRE:
        return {robot_specs.LIDAR_PLUGIN: {"port": f"{SIMULATED}{LINE}", "range_max_m": lidar.range_max_m, **mount}}
    return {robot_specs.LIDAR_PLUGIN: mount} if mount else {}


def manifest_texts(world: World, team: str = DEFAULT_TEAM) -> dict[str, str]:
    """The robots' files and the manifests of the stock plugins, by a path for each."""
    texts = {
        f"robots/{robot.name}.toml": msgspec.toml.encode(world.robot_file(robot, team=team)).decode()
        for robot in world.robots
    }
    for name, path in PluginFolders([stock_place()]).find().items():
        texts[f"plugins/{name}.toml"] = path.read_text(encoding="utf-8")
    return texts
