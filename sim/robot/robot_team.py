"""All robots of an arena, updated together: arrays for the work of every tick, calls for work that is due."""

import math
from collections.abc import Sequence

import numpy as np
import pymunk
from numpy.typing import NDArray

from robrain.algorithms.mapping.ray_cast import SOLID
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.firmware.disturbance import Disturbance
from robrain.sim.firmware.motor_controller import ENCODER_IDENTIFIER, WheelEncoders
from robrain.sim.firmware.power_model import LOAD, add_motion
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.surfaces import FloorSurfaces
from robrain.sim.maps.wall_shapes import add_walls
from robrain.sim.robot.robot_body import COLLISION_SLOP_M, MASS_KG, OVERLAP_LEFT_PER_TICK, CollisionCounter, RobotBodies
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.robot.simulated_robot import SimulatedRobot
from robrain.sim.traffic.specs import WALL_COLLISION
from robrain.sim.traffic.traffic import SeenWalls, Traffic, TrafficPlan


class RobotTeam:
    """Robots with bodies, firmware and sensors, and the doors, obstacles and people that they meet.

    Args:
        plan: the floor.
        walls: (H, W) cells that robots and cameras see; writable, doors and people change it.
        geometry: placement of `walls` in the arena frame.
        specs: the robots, in this order.
        endpoint: the arena's place on the wire.
        rng: the source of all randomness.
        tick_s: length of a tick.
        surfaces: glass and mirrors among the walls; None if there are none.
        disturbance: delays of frames and scans.
        traffic: doors, moving obstacles and people; None if there are none.

    """

    def __init__(
        self,
        plan: FloorPlan,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        specs: Sequence[ArenaRobot],
        endpoint: Endpoint,
        rng: np.random.Generator,
        tick_s: float,
        surfaces: FloorSurfaces | None,
        disturbance: Disturbance,
        traffic: TrafficPlan | None,
    ) -> None:
        self._space = space = pymunk.Space()
        space.collision_slop = COLLISION_SLOP_M
        space.collision_bias = OVERLAP_LEFT_PER_TICK ** (1.0 / tick_s)
        add_walls(space, plan, collision_type=WALL_COLLISION)
        self.robots = robots = list[SimulatedRobot]()
        try:
            for index, (spec, own_rng) in enumerate(zip(specs, rng.spawn(len(specs)), strict=True)):
                robots.append(
                    SimulatedRobot(
                        spec, space, walls, geometry, endpoint, index, tick_s, own_rng, surfaces, disturbance
                    )
                )
        except BaseException:
            self.close()  # the caller has no team to close
            raise
        self.traffic: Traffic | None = None
        others: Sequence[pymunk.Body] = ()
        circles: NDArray[np.float64] = np.zeros((0, 3))
        if traffic is not None:
            seen: list[SeenWalls] = [(walls, 1)]
            if surfaces is not None:
                seen.append((surfaces.cells, SOLID))
            self.traffic = Traffic(traffic, plan, space, seen, [spec.disc for spec in specs], tick_s)
            others, circles = self.traffic.bodies, self.traffic.circles
        self.bodies = RobotBodies(space, [robot.body for robot in robots], tick_s, others)
        shapes = self.traffic.shapes if self.traffic is not None else ()
        self._collisions = CollisionCounter(space, self.bodies, tick_s, shapes)
        self.collisions = self._collisions.count
        """Of each robot."""
        self._tick_s = tick_s
        self._loads = np.zeros(len(robots), LOAD)
        for row, robot in enumerate(robots):
            self._loads[row] = robot.power.row(MASS_KG)
        self._encoders = WheelEncoders(np.array([robot.controller.ticks_per_rad for robot in robots]))
        self._hulls = np.zeros((len(robots) + len(circles), 3))
        """x, y, radius of each robot, arena frame, filled in for a scan; then those of the circles."""
        self._hulls[: len(robots), 2] = [robot.body.radius_m for robot in robots]
        self.circles = self._hulls[len(robots) :]
        """(K, 3), kept up to date by their owner."""
        self.circles[:] = circles
        self._at = self._hulls[: len(robots)]
        turns = math.lcm(*[robot.ranges.period_ticks for robot in robots])
        self._ranging = [[robot for robot in robots if robot.ranges.measures_at(tick)] for tick in range(turns)]
        """Robots whose range sensors measure in a tick, by its remainder."""
        self._sweeping = [robot for robot in robots if robot.line is not None]
        self._with_imu = [robot for robot in robots if robot.has_imu]
        self._described = [(robot.body, robot.described) for robot in robots if robot.described is not None]
        self._three_wheels = [(row, robot.bus) for row, robot in enumerate(robots) if robot.described is None]
        """Rows and buses of the robots whose encoder frames are made together."""
        self._late = [robot for robot in robots if robot.is_late]

    def move(self, tick: int) -> None:
        """Read the buses, set the wheels, and move all bodies."""
        if self.traffic is not None:
            hulls = [(body.x_m, body.y_m, body.radius_m) for body in self.bodies.bodies]
            self.traffic.step(tick * self._tick_s, hulls, self.bodies.other_velocities, self.circles)
        wanted_rad_s = self.bodies.wanted_rad_s
        for row, robot in enumerate(self.robots):
            controller = robot.controller
            if robot.pending or tick >= controller.due_tick or controller.has_failed:
                controller.receive(tick)
                wanted_rad_s[row] = controller.wheel_speeds_rad_s
        self.bodies.drive()
        self._space.step(self._tick_s)
        self._collisions.tick = tick

    def report(self, tick: int) -> None:
        """Update the bodies' motion, and send the measurements of firmware and sensors."""
        bodies = self.bodies
        bodies.roll()
        add_motion(self._loads, bodies.state, self._tick_s)
        before = tick - 1  # the first tick is 1, and everything but the battery's status is due in it
        robots = self.robots
        if robots and before % robots[0].controller.encoder_period_ticks == 0:
            frames = self._encoders.frames(bodies.turns_rad)
            for row, bus in self._three_wheels:
                bus.send_data(ENCODER_IDENTIFIER, frames[row])
        for body, described in self._described:
            described.roll(body.forward_m, body.left_m, body.turned_rad)
            if before % described.encoder_period_ticks == 0:
                described.send_counts()
        for robot in self._with_imu:
            robot.measure_turning()
        for row, robot in enumerate(robots):
            controller, ranges = robot.controller, robot.ranges
            if robot.bus.transmit_errors:
                controller.check_errors()
            if controller.has_news or before % controller.status_period_ticks == 0:
                controller.send_status()
            contacts_rad = robot.body.contacts_rad
            if contacts_rad or ranges.reported or tick % ranges.bump_period_ticks == ranges.phase:
                ranges.feel(tick, robot.body.yaw_rad, contacts_rad)
            if tick % robot.manager.period_ticks == 0:
                robot.manager.measure(float(self._loads[row]["motion_j"]))
                self._loads[row]["motion_j"] = 0.0
                if controller.powered == robot.battery.is_cut_off:  # it has cut off or come back in this tick
                    controller.powered = not robot.battery.is_cut_off
                    bodies.wanted_rad_s[row] = controller.wheel_speeds_rad_s
        self._sense(tick)

    def close(self) -> None:
        """Leave the robots' buses."""
        for robot in self.robots:
            robot.bus.shutdown()

    def _sense(self, tick: int) -> None:
        """Measure the ranges and scan with the lidars that are due; then forward late messages."""
        due = [robot for robot in self.robots if tick % robot.scan_period_ticks == robot.scan_phase]
        ranging = self._ranging[tick % len(self._ranging)]
        if due or ranging or self._sweeping:
            self._at[:, 0], self._at[:, 1] = self.bodies.state["x_m"], self.bodies.state["y_m"]
            for robot in ranging:
                robot.ranges.measure(robot.body.pose, self._hulls)
            for robot in due:
                robot.scan(self._hulls)
            for robot in self._sweeping:
                robot.sweep(self._hulls)
        for robot in self._late:
            robot.deliver()
