"""Robots that are points: an exact pose on the floor, and a battery that follows the energy model.

They drive along paths at constant speed, stop before they touch each other, and turn at once. The plugins of this
folder replace those that need a body, a bus or a sensor.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robrain.agent.environment import Environment
from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.algorithms.navigation.navigation_grid import clearance_m
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.faults.fault_spec import HARDWARE, FaultKind, FaultSpec
from robrain.sim.firmware.battery import J_PER_WH
from robrain.sim.firmware.motor_controller import WATCHDOG_S
from robrain.sim.maps.floor_plan import classes_on
from robrain.sim.robot.robot_body import MASS_KG
from robrain.sim.robot.robot_hardware import ArenaRobot

POINT_TICK_S = 0.2
ROLES = {name: f"point_{name}" for name in ("driver", "localisation", "mapper", "battery")}
"""Plugins of this folder, by the plugin that each replaces."""
PLACE = Path(__file__).parent
HARDWARE_PLUGINS = ("mocdevice", "scan", "range_sensors", "bm2", "imu")
"""Stock plugins of hardware that points lack."""
POSSIBLE = (frozenset(FaultKind) - HARDWARE) | {FaultKind.MOTE_BASE_FLOODS, FaultKind.CARRIED_OFF}
"""Faults that points can have."""
STOP_M = 0.02
"""Robots stop this far before they would touch each other."""
AT_REST = Twist2D()


class PointFloor:
    """The true floor.

    Args:
        walls: (H, W) solid cells.
        geometry: placement of `walls` in the arena frame.

    """

    def __init__(self, walls: NDArray[np.bool_], geometry: GridGeometry) -> None:
        self._walls = walls
        self._geometry = geometry

    def ranges_m(self, pose: Pose2D, angles_rad: Floats, range_max_m: float) -> Floats:
        """(N,) distances to the walls, without noise; inf beyond `range_max_m`."""
        ranges_m = cast_rays_of(self._walls, self._geometry, pose, angles_rad, range_max_m, np.empty((0, 3)))
        ranges_m[ranges_m >= range_max_m] = math.inf
        return ranges_m

    def classes(self, geometry: GridGeometry) -> NDArray[np.int8]:
        """(H, W) of another grid: OCCUPIED at the surfaces of walls, FREE between them, UNKNOWN elsewhere."""
        walls = self._walls
        return classes_on(geometry, self._geometry, ~walls, walls & (clearance_m(~walls, 1.0, 2.0) < 2.0))


class PointRobot:
    """One robot: its pose, its path and its battery.

    Args:
        spec: its construction, and its start.
        floor: on which it drives.

    """

    def __init__(self, spec: ArenaRobot, floor: PointFloor) -> None:
        self.name = spec.name
        self.floor = floor
        self.radius_m = spec.radius_m
        self.lidar = spec.lidar
        self.x_m, self.y_m, self.yaw_rad = spec.start.x_m, spec.start.y_m, spec.start.yaw_rad
        """Pose in the arena frame."""
        self.forward_m, self.left_m, self.turned_rad = 0.0, 0.0, 0.0
        """Displacement of the last tick in the body frame."""
        self.distance_m = 0.0
        """Length of the path since the start."""
        self.was_carried = False
        self.capacity_j = spec.battery.capacity_wh * J_PER_WH * (1.0 - spec.battery.capacity_fade)
        self.energy_j = spec.battery.soc_at_start * self.capacity_j
        """Energy that the battery can still deliver."""
        self.delivered_j = 0.0
        """Energy that the battery has delivered so far."""
        self.supply_w = 0.0
        """Power that a charger gives."""
        self.power_w = 0.0
        """Power drawn in the last tick, without the charger's."""
        self.is_driving = False
        self.blocked_s = 0.0
        """Time for which another robot has been in its way; 0 if none is."""
        self._power = spec.power
        self._idle_total_w = spec.power.idle_total_w(bursting=False)
        self._moving_w: dict[float, float] = {}
        self._path: list[tuple[float, float]] = []
        """Points that remain, the last one first."""
        self._speed_m_s = 0.0
        self._uncommanded_s = 0.0
        self.pose = spec.start
        """As of the last tick."""

    @property
    def soc(self) -> float:
        """State of charge, 0 to 1."""
        return self.energy_j / self.capacity_j

    @property
    def velocity(self) -> Twist2D:
        """In the body frame."""
        return Twist2D(forward_m_s=self._speed_m_s) if self.forward_m else AT_REST

    def follow(self, path: Sequence[Point2D], speed_m_s: float) -> None:
        """Drive along these points, arena frame; `command` must be repeated meanwhile."""
        self._path = [(point.x_m, point.y_m) for point in reversed(path)]
        self._speed_m_s = speed_m_s
        self._uncommanded_s = 0.0
        self.is_driving = bool(self._path)

    def command(self) -> None:
        """Continue on the path: a robot stands `WATCHDOG_S` after the last call."""
        self._uncommanded_s = 0.0

    def stop(self) -> None:
        """Stand still."""
        self._path.clear()
        self.is_driving = False
        self.blocked_s = 0.0

    def remaining_m(self) -> float:
        """Length of the rest of the path."""
        x_m, y_m, length_m = self.x_m, self.y_m, 0.0
        for to_x_m, to_y_m in reversed(self._path):
            length_m += math.hypot(to_x_m - x_m, to_y_m - y_m)
            x_m, y_m = to_x_m, to_y_m
        return length_m

    def face(self, yaw_rad: float) -> None:
        """Turn on the spot, at once."""
        self.yaw_rad = math.remainder(yaw_rad, math.tau)
        self.pose = Pose2D(self.x_m, self.y_m, self.yaw_rad)

    def carry_to(self, pose: Pose2D) -> None:
        """A person picks the robot up and puts it down here."""
        self.x_m, self.y_m, self.yaw_rad, self.pose = pose.x_m, pose.y_m, pose.yaw_rad, pose

    def set_fault(self, fault: FaultSpec, *, breaks: bool) -> None:
        """Apply a fault now; there is nothing to repair."""
        if fault.kind is FaultKind.CARRIED_OFF:
            assert fault.place_m is not None  # FaultSpec has checked it
            self.carry_to(Pose2D(*fault.place_m, fault.yaw_rad))
        elif fault.kind is FaultKind.DRAIN:
            assert fault.soc is not None
            self.energy_j = min(self.energy_j, fault.soc * self.capacity_j)

    def supply(self, supply_w: float) -> None:
        """Charge with this power from now on."""
        self.supply_w = supply_w

    def drop_commands(self) -> None:
        """A computer that was killed sends nothing more; the watchdog stops the robot."""

    def step(self, period_s: float, others: Floats) -> None:
        """Move on, and draw from the battery.

        Args:
            period_s: duration of the step.
            others: (N, 3) x, y and radius of all robots, arena frame.

        """
        self.forward_m = 0.0
        power_w = self._idle_total_w
        if self._path:
            self._uncommanded_s += period_s
            if self._uncommanded_s > WATCHDOG_S + 0.5 * period_s:
                self.stop()
            elif self.energy_j > 0.0:
                self._move(self._speed_m_s * period_s, others)
                moving_w = self._moving_w.get(self._speed_m_s)
                if moving_w is None:
                    moving_w = self._power.motion_w(self._speed_m_s, 0.0, MASS_KG)
                    self._moving_w[self._speed_m_s] = moving_w
                power_w += moving_w
        if self.energy_j <= 0.0:
            power_w = 0.0
        self.power_w = power_w
        self.delivered_j += power_w * period_s
        self.energy_j = min(self.capacity_j, max(0.0, self.energy_j + (self.supply_w - power_w) * period_s))

    def _move(self, reach_m: float, others: Floats) -> None:
        """Move on, unless that would bring it too near to another robot."""
        path, x_m, y_m = self._path, self.x_m, self.y_m
        left_m, yaw_rad, passed = reach_m, self.yaw_rad, 0
        while passed < len(path) and left_m > 0.0:
            to_x_m, to_y_m = path[-1 - passed]
            ahead_x_m, ahead_y_m = to_x_m - x_m, to_y_m - y_m
            away_m = math.hypot(ahead_x_m, ahead_y_m)
            if away_m > 0.0:
                yaw_rad = math.atan2(ahead_y_m, ahead_x_m)
            if away_m > left_m:
                share = left_m / away_m
                x_m += share * ahead_x_m
                y_m += share * ahead_y_m
                left_m = 0.0
            else:
                x_m, y_m = to_x_m, to_y_m
                left_m -= away_m
                passed += 1
        then_m = np.hypot(others[:, 0] - x_m, others[:, 1] - y_m)
        is_near = then_m < others[:, 2] + self.radius_m + STOP_M
        if is_near.sum() > 1:  # it is near to itself
            now_m = np.hypot(others[:, 0] - self.x_m, others[:, 1] - self.y_m)
            if (is_near & (now_m > then_m)).any():
                self.blocked_s += reach_m / self._speed_m_s
                return
        self.blocked_s = 0.0
        del path[len(path) - passed :]
        self.is_driving = bool(path)
        self.x_m, self.y_m, self.yaw_rad = x_m, y_m, yaw_rad
        self.pose = Pose2D(x_m, y_m, yaw_rad)
        self.forward_m = reach_m - left_m
        self.distance_m += self.forward_m


class PointTeam:
    """All robots of an arena.

    Args:
        specs: the robots, in this order.
        floor: on which they drive.
        tick_s: length of a tick.

    """

    traffic = None

    def __init__(self, specs: Sequence[ArenaRobot], floor: PointFloor, tick_s: float) -> None:
        self.robots = [PointRobot(spec, floor) for spec in specs]
        self.collisions = [0] * len(specs)
        """Of each robot: points do not collide."""
        self._tick_s = tick_s

    def move(self, tick: int) -> None:
        """Move all robots."""
        places = np.array([(robot.x_m, robot.y_m, robot.radius_m) for robot in self.robots]).reshape(-1, 3)
        for place, robot in zip(places, self.robots, strict=True):
            robot.step(self._tick_s, places)
            place[:2] = robot.x_m, robot.y_m

    def report(self, tick: int) -> None:
        """Points have no sensors that send messages."""

    def close(self) -> None:
        """There are no resources to close."""


def robot_of(env: Environment) -> PointRobot:
    """The robot that a plugin of this folder belongs to."""
    robot = env.board.hardware
    assert isinstance(robot, PointRobot)  # the run has set it
    return robot
