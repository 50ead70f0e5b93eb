"""All robots of an arena, moved on together: arrays for what every robot does in every tick, calls for what is due."""

import math
from collections.abc import Sequence

import numpy as np
import pymunk
from numpy.typing import NDArray

from robrain.sim.firmware.load_kernel import LOAD, add_motion
from robrain.sim.firmware.wheel_encoders import ENCODER_IDENTIFIER, WheelEncoders
from robrain.sim.robot.robot_body import RobotBodies
from robrain.sim.robot.simulated_robot import SimulatedRobot

NO_CIRCLES = np.zeros((0, 3))


class RobotTeam:
    """The robots' ticks: `act()`, the step of the space, `report()`, `sense()`.

    Args:
        robots: in the order in which they were added to the space.
        space: where their bodies move.
        tick_s: how long a tick is.
        others: bodies in the space that are no robots, added after them.
        circles: (K, 3) x, y, radius of what is round among these, as sensors see it; arena frame.

    """

    def __init__(
        self,
        robots: Sequence[SimulatedRobot],
        space: pymunk.Space,
        tick_s: float,
        others: Sequence[pymunk.Body] = (),
        circles: NDArray[np.float64] = NO_CIRCLES,
    ) -> None:
        self.bodies = RobotBodies(space, [robot.body for robot in robots], tick_s, others)
        self._robots = robots
        self._tick_s = tick_s
        self._loads = np.zeros(len(robots), LOAD)
        for row, robot in enumerate(robots):
            self._loads[row] = robot.manager.load.row()
        self._encoders = WheelEncoders(np.array([robot.controller.ticks_per_rad for robot in robots]))
        self._hulls = np.zeros((len(robots) + len(circles), 3))
        """x, y, radius of each robot, arena frame, filled in when somebody scans; then those of the circles."""
        self._hulls[: len(robots), 2] = [robot.body.radius_m for robot in robots]
        self.circles = self._hulls[len(robots) :]
        """(K, 3), kept up to date by their owner."""
        self.circles[:] = circles
        self._at = self._hulls[: len(robots)]
        turns = math.lcm(*[robot.ranges.period_ticks for robot in robots])
        self._ranging = [[robot for robot in robots if robot.ranges.measures_at(tick)] for tick in range(turns)]
        """Whose range sensors measure in a tick, by its remainder."""
        self._sweeping = [robot for robot in robots if robot.line is not None]
        self._with_imu = [robot for robot in robots if robot.has_imu]
        self._described = [robot for robot in robots if robot.described is not None]
        self._three_wheels = [(row, robot.bus) for row, robot in enumerate(robots) if robot.described is None]
        """Rows and buses of the robots whose encoder frames are made together."""
        self._late = [robot for robot in robots if robot.is_late]

    def act(self, tick: int) -> None:
        """Hear the buses, set the wheels."""
        wanted_rad_s = self.bodies.wanted_rad_s
        for row, robot in enumerate(self._robots):
            controller = robot.controller
            if robot.pending or tick >= controller.due_tick or controller.has_failed:
                controller.receive(tick)
                wanted_rad_s[row] = controller.wheel_speeds_rad_s
        self.bodies.drive()

    def report(self, tick: int) -> None:
        """Follow the bodies' motion and tell it on the buses."""
        bodies = self.bodies
        bodies.roll()
        add_motion(self._loads, bodies.state, self._tick_s)
        before = tick - 1  # the first tick is 1, and everything but the battery's status is due in it
        robots = self._robots
        if robots and before % robots[0].controller.encoder_period_ticks == 0:
            frames = self._encoders.frames(bodies.turns_rad)
            for row, bus in self._three_wheels:
                bus.send_data(ENCODER_IDENTIFIER, frames[row])
        for robot in self._described:
            self._follow(robot, before)
        for robot in self._with_imu:
            robot.measure_turning()
        for row, robot in enumerate(robots):
            controller, ranges = robot.controller, robot.ranges
            if robot.bus.transmit_errors:
                controller.check_errors()
            if controller.has_news or before % controller.status_period_ticks == 0:
                controller.tell()
            contacts_rad = robot.body.contacts_rad
            if contacts_rad or ranges.told or tick % ranges.bump_period_ticks == ranges.phase:
                ranges.feel(tick, robot.body.yaw_rad, contacts_rad)
            if tick % robot.manager.period_ticks == 0:
                robot.manager.load.motion_j = float(self._loads[row]["motion_j"])
                self._loads[row]["motion_j"] = 0.0
                robot.manager.measure()
                if controller.powered == robot.battery.is_cut_off:  # it has cut off or come back in this tick
                    controller.powered = not robot.battery.is_cut_off
                    bodies.wanted_rad_s[row] = controller.wheel_speeds_rad_s

    def _follow(self, robot: SimulatedRobot, before: int) -> None:
        controller, body = robot.described, robot.body
        if controller is not None:
            controller.roll(body.forward_m, body.left_m, body.turned_rad)
            if before % controller.encoder_period_ticks == 0:
                controller.send_counts()

    def sense(self, tick: int) -> None:
        """Measure the ranges and scan with the lidars that are due; then pass on what was late."""
        due = [robot for robot in self._robots if tick % robot.scan_period_ticks == robot.scan_phase]
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
