"""The body of a simulated robot: a round base on three omni wheels, pushed and stopped by what it meets.

The wheels turn with the body's true motion, also when a wall holds it. Without errors and slip (`wheels`) the
encoders thus tell the truth up to their resolution.
"""

import math
from collections.abc import Sequence

import pymunk

from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.sim.robot.wheels import Wheels

ROBOT_COLLISION, WALL_COLLISION = 1, 2
"""Collision types of shapes in the arena's space."""

MASS_KG = 4.0
ACCELERATION_MAX_M_S2 = 1.5
"""What the wheels hold on the floor; turning at speed takes its share of it."""
YAW_ACCELERATION_MAX_RAD_S2 = 6.0
FRICTION = 0.4
COLLISION_SLOP_M = 0.001
"""Overlap that the solver leaves, so that what rests stays in touch. pymunk's own 0.1 is meant for pixels."""
OVERLAP_LEFT_PER_TICK = 0.6
"""Share of an overlap that is left after a tick; stiffer than pymunk's 0.9 a sixtieth of a second."""
APART_S = 0.5
"""Two that touch again within this have not parted; a robot that rattles along a wall meets it once."""


class RobotBody:
    """One robot in the space of the arena.

    A tick is `drive()`, then the step of the space, then `roll()`.

    Args:
        space: where its body and shape are added.
        wheels: the three of them, as they truly are.
        start: pose in the arena frame.
        radius_m: of the round hull.
        tick_s: how long a tick is.

    """

    def __init__(self, space: pymunk.Space, wheels: Wheels, start: Pose2D, radius_m: float, tick_s: float) -> None:
        self.wheels = wheels
        self.radius_m = radius_m
        self.x_m, self.y_m, self.yaw_rad = start.x_m, start.y_m, start.yaw_rad
        """Pose in the arena frame; the yaw is not wrapped."""
        self.forward_m, self.left_m, self.turned_rad = 0.0, 0.0, 0.0
        """Displacement of the last tick in the body frame, at the yaw halfway."""
        self.wheel_turns_rad = [0.0, 0.0, 0.0]
        """How far each wheel has turned since the start."""
        self.contacts_rad: list[float] = []
        """Where something has touched the hull in the last tick: directions in the arena frame, from the centre."""
        self.distance_m = 0.0
        """Length of the way since the start."""
        self._tick_s = tick_s
        self._speed_change_m_s = ACCELERATION_MAX_M_S2 * tick_s
        self._yaw_rate_change_rad_s = YAW_ACCELERATION_MAX_RAD_S2 * tick_s
        self._body = pymunk.Body(MASS_KG, pymunk.moment_for_circle(MASS_KG, 0.0, radius_m))
        self._body.position = start.x_m, start.y_m
        self._body.angle = start.yaw_rad
        self.shape = pymunk.Circle(self._body, radius_m)
        self.shape.collision_type = ROBOT_COLLISION
        self.shape.friction = FRICTION
        space.add(self._body, self.shape)

    @property
    def pose(self) -> Pose2D:
        """Where it is, arena frame; yaw in [−π, π]."""
        return Pose2D(self.x_m, self.y_m, math.remainder(self.yaw_rad, math.tau))

    @property
    def place_m(self) -> tuple[float, float]:
        """Where it is now, also in the middle of a step of the space; arena frame."""
        x_m, y_m = self._body.position
        return x_m, y_m

    def drive(self, wheel_1_rad_s: float, wheel_2_rad_s: float, wheel_3_rad_s: float) -> None:
        """Bring the body's velocity as near to that of these wheel speeds as the acceleration allows in a tick."""
        self.contacts_rad.clear()
        wanted = self.wheels.twist(wheel_1_rad_s, wheel_2_rad_s, wheel_3_rad_s)
        body = self._body
        yaw_rate_rad_s = body.angular_velocity
        limit = self._yaw_rate_change_rad_s
        yaw_rate_rad_s += max(-limit, min(limit, wanted.yaw_rad_s - yaw_rate_rad_s))

        # Velocity is constant during a step while the yaw turns: halfway through it is where both agree.
        halfway_rad = self.yaw_rad + 0.5 * yaw_rate_rad_s * self._tick_s
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        x_m_s, y_m_s = body.velocity
        change_x_m_s = cos * wanted.forward_m_s - sin * wanted.left_m_s - x_m_s
        change_y_m_s = sin * wanted.forward_m_s + cos * wanted.left_m_s - y_m_s
        change_m_s = math.hypot(change_x_m_s, change_y_m_s)
        share = self._speed_change_m_s / change_m_s if change_m_s > self._speed_change_m_s else 1.0
        body.velocity = x_m_s + share * change_x_m_s, y_m_s + share * change_y_m_s
        body.angular_velocity = yaw_rate_rad_s

    def carry_to(self, pose: Pose2D) -> None:
        """Somebody picks the robot up and puts it down here, at rest: its wheels do not turn."""
        self.x_m, self.y_m, self.yaw_rad = pose.x_m, pose.y_m, pose.yaw_rad
        self._body.position = pose.x_m, pose.y_m
        self._body.angle = pose.yaw_rad
        self._body.velocity = 0.0, 0.0
        self._body.angular_velocity = 0.0

    def roll(self) -> None:
        """Follow the body after the step of the space: pose, way and wheels."""
        x_m, y_m = self._body.position
        yaw_rad = self._body.angle
        dx_m, dy_m = x_m - self.x_m, y_m - self.y_m
        self.turned_rad = yaw_rad - self.yaw_rad
        halfway_rad = self.yaw_rad + 0.5 * self.turned_rad
        self.x_m, self.y_m, self.yaw_rad = x_m, y_m, yaw_rad
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        self.forward_m = cos * dx_m + sin * dy_m
        self.left_m = cos * dy_m - sin * dx_m
        self.distance_m += math.hypot(dx_m, dy_m)
        turns_rad = self.wheels.turns_rad(Twist2D(self.forward_m, self.left_m, self.turned_rad))
        for wheel, turn_rad in enumerate(turns_rad):
            self.wheel_turns_rad[wheel] += turn_rad


class CollisionCounter:
    """Counts for each robot how often it began to touch a wall or another robot.

    It also notes on the bodies where they are touched. All walls are one partner, thus sliding from one wall's shape to
    the next is no new collision. `count[i]` is that of the i-th robot; `step()` is due once a tick.
    """

    def __init__(self, space: pymunk.Space, robots: Sequence[RobotBody], tick_s: float) -> None:
        self.count = [0] * len(robots)
        self._robots = robots
        self._index: dict[pymunk.Shape, int] = {robot.shape: index for index, robot in enumerate(robots)}
        self._touching: dict[tuple[int, int], int] = {}
        self._parted_tick: dict[tuple[int, int], int] = {}
        self._apart_ticks = round(APART_S / tick_s)
        self._tick = 0
        for other in (ROBOT_COLLISION, WALL_COLLISION):
            space.on_collision(
                ROBOT_COLLISION, other, begin=self._begin, separate=self._separate, post_solve=self._touch
            )

    def step(self) -> None:
        """Go on by a tick."""
        self._tick += 1

    def _begin(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        pair = self._pair(arbiter)
        touching = self._touching.get(pair, 0)
        self._touching[pair] = touching + 1
        if touching or self._tick - self._parted_tick.get(pair, -self._apart_ticks) < self._apart_ticks:
            return
        for index in pair:
            if index != _WALL:
                self.count[index] += 1

    def _separate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        pair = self._pair(arbiter)
        self._touching[pair] -= 1
        self._parted_tick[pair] = self._tick

    def _touch(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        for shape in arbiter.shapes:
            index = self._index.get(shape, _WALL)
            if index != _WALL:
                robot = self._robots[index]
                x_m, y_m = robot.place_m
                for contact in arbiter.contact_point_set.points:
                    point = contact.point_a
                    robot.contacts_rad.append(math.atan2(point.y - y_m, point.x - x_m))

    def _pair(self, arbiter: pymunk.Arbiter) -> tuple[int, int]:
        one, other = (self._index.get(shape, _WALL) for shape in arbiter.shapes)
        return min(one, other), max(one, other)


_WALL = -1
