"""The bodies of simulated robots: round bases on three omni wheels, pushed and stopped by obstacles.

The wheels turn with the body's true motion, also when a wall holds it. Without errors and slip (`wheels`) the encoders
are thus exact up to their resolution. Compiled loops move all bodies of an arena in one tick, over arrays with a row
for each robot. A length is the root of a sum of squares, which is the same on all processors and in every C library.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import pymunk
import pymunk.batch
from numba import njit
from numpy.typing import NDArray
from pymunk.batch import BodyFields

from robrain.algorithms.navigation.wheel_bases import TANGENTS, WHEEL_ANGLES_RAD
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.robot.wheels import DRAWS, Wheels
from robrain.sim.traffic.specs import FRICTION, MOVER_COLLISION, ROBOT_COLLISION, WALL_COLLISION

MOVED = ("x_m", "y_m", "yaw_rad", "forward_m", "left_m", "turned_rad", "distance_m")
"""Fields of a body that a tick changes, in the order of `STATE`."""
STATE = np.dtype([(name, "f8") for name in MOVED])
"""Pose in the arena frame, displacement of the last tick in the body frame, and the path length since the start."""

WHEELS = np.dtype(
    [
        ("radius_m", "f8"),
        ("distance_m", "f8"),
        ("path_per_turn", "f8", (3,)),
        ("lateral_slip", "f8"),
        ("slip_m2_per_m", "f8"),
        ("lateral_m2_per_m", "f8"),
    ]
)
"""The true wheels of a robot. The last two are variances of slips along the tread: per metre along it, and per metre
along the axle."""

MOTION = 6
"""Columns of a body's motion in the space: x, y, yaw, and their rates, in m, rad and seconds, arena frame."""
_AXLES = tuple((math.cos(angle), math.sin(angle)) for angle in WHEEL_ANGLES_RAD)


@njit(cache=True)
def drive(
    state: NDArray[np.void],
    motion: Floats,
    wheels: NDArray[np.void],
    wanted_rad_s: Floats,
    velocities: Floats,
    tick_s: float,
    speed_change_m_s: float,
    yaw_rate_change_rad_s: float,
) -> None:
    """Bring each body's velocity as near to that of its wheels as the acceleration allows in a tick.

    Args:
        state: (N,) `STATE`.
        motion: (N, `MOTION`).
        wheels: (N,) `WHEELS`.
        wanted_rad_s: (N, 3) speeds of the wheels.
        velocities: (N, 3) x, y and yaw rate in the arena frame: the result.
        tick_s: length of a tick.
        speed_change_m_s: greatest change of the velocity in a tick.
        yaw_rate_change_rad_s: greatest change of the yaw rate in a tick.

    """
    for i in range(state.shape[0]):
        wheel = wheels[i]
        v1 = wheel.radius_m * (wheel.path_per_turn[0] * wanted_rad_s[i, 0])
        v2 = wheel.radius_m * (wheel.path_per_turn[1] * wanted_rad_s[i, 1])
        v3 = wheel.radius_m * (wheel.path_per_turn[2] * wanted_rad_s[i, 2])
        forward_m_s = (2 / 3) * (TANGENTS[0][0] * v1 + TANGENTS[1][0] * v2 + TANGENTS[2][0] * v3)
        left_m_s = (2 / 3) * (TANGENTS[0][1] * v1 + TANGENTS[1][1] * v2 + TANGENTS[2][1] * v3)
        wanted_yaw_rate = (v1 + v2 + v3) / (3 * wheel.distance_m)
        yaw_rate_rad_s = motion[i, 5]
        change_rad_s = wanted_yaw_rate - yaw_rate_rad_s
        yaw_rate_rad_s += max(-yaw_rate_change_rad_s, min(yaw_rate_change_rad_s, change_rad_s))

        # Velocity is constant during a step while the yaw turns: halfway through it is where both agree.
        halfway_rad = state[i].yaw_rad + 0.5 * yaw_rate_rad_s * tick_s
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        x_m_s, y_m_s = motion[i, 3], motion[i, 4]
        change_x_m_s = cos * forward_m_s - sin * left_m_s - x_m_s
        change_y_m_s = sin * forward_m_s + cos * left_m_s - y_m_s
        change_m_s = math.sqrt(change_x_m_s * change_x_m_s + change_y_m_s * change_y_m_s)
        share = speed_change_m_s / change_m_s if change_m_s > speed_change_m_s else 1.0
        velocities[i, 0] = x_m_s + share * change_x_m_s
        velocities[i, 1] = y_m_s + share * change_y_m_s
        velocities[i, 2] = yaw_rate_rad_s


@njit(cache=True)
def roll(
    state: NDArray[np.void],
    motion: Floats,
    wheels: NDArray[np.void],
    turns_rad: Floats,
    normals: Floats,
    used: NDArray[np.int64],
    refill_at: int,
) -> bool:
    """Update the bodies after a step of the space: pose, displacement, path length and turns of the wheels.

    Args:
        state: (N,) `STATE`, updated in place.
        motion: (N, `MOTION`).
        wheels: (N,) `WHEELS`.
        turns_rad: (N, 3) turn of each wheel since the start; updated in place.
        normals: (N, K) normal random numbers of the slips; at least three of each row must be unused.
        used: (N,) number of used values of each row; updated in place.
        refill_at: number of used values from which a row needs more.

    Returns:
        Whether a row needs more.

    """
    needs_more = False
    for i in range(state.shape[0]):
        body, wheel = state[i], wheels[i]
        dx_m, dy_m = motion[i, 0] - body.x_m, motion[i, 1] - body.y_m
        turned_rad = motion[i, 2] - body.yaw_rad
        halfway_rad = body.yaw_rad + 0.5 * turned_rad
        body.x_m, body.y_m, body.yaw_rad = motion[i, 0], motion[i, 1], motion[i, 2]
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        forward_m = cos * dx_m + sin * dy_m
        left_m = cos * dy_m - sin * dx_m
        body.forward_m, body.left_m, body.turned_rad = forward_m, left_m, turned_rad
        body.distance_m += math.sqrt(dx_m * dx_m + dy_m * dy_m)

        turning_m = wheel.distance_m * turned_rad
        for k in range(3):
            turn_rad = (TANGENTS[k][0] * forward_m + TANGENTS[k][1] * left_m + turning_m) / wheel.radius_m
            along_axle_m = _AXLES[k][0] * forward_m + _AXLES[k][1] * left_m
            slip_m = wheel.lateral_slip * along_axle_m
            # Of the slip along the tread: a random walk, whose variance grows with the path length.
            along_tread_m2 = wheel.slip_m2_per_m * abs(turn_rad) * wheel.radius_m
            variance_m2 = along_tread_m2 + wheel.lateral_m2_per_m * abs(along_axle_m)
            if variance_m2 > 0:
                slip_m += math.sqrt(variance_m2) * normals[i, used[i]]
                used[i] += 1
            turns_rad[i, k] += (turn_rad + slip_m / wheel.radius_m) / wheel.path_per_turn[k]
        needs_more = needs_more or used[i] >= refill_at
    return needs_more


MASS_KG = 4.0
ACCELERATION_MAX_M_S2 = 1.5
"""Acceleration that the wheels' grip allows; turning at speed uses its share of it."""
YAW_ACCELERATION_MAX_RAD_S2 = 6.0
COLLISION_SLOP_M = 0.001
"""Overlap that the solver leaves, so that resting bodies stay in touch. pymunk's own 0.1 is meant for pixels."""
OVERLAP_LEFT_PER_TICK = 0.6
"""Share of an overlap that is left after a tick; stiffer than pymunk's 0.9 a sixtieth of a second."""
APART_S = 0.5
"""Two that touch again within this have not parted; a robot that rattles along a wall meets it once."""


_RATES = BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
_POSE_AND_RATES = BodyFields.POSITION | BodyFields.ANGLE | _RATES


class Body(Protocol):
    """A robot as the arena's other parts see it, as of the last tick."""

    x_m: float
    y_m: float
    yaw_rad: float
    """Arena frame, as x and y; may be not wrapped."""
    radius_m: float
    forward_m: float
    left_m: float
    """Displacement of the last tick, body frame."""
    distance_m: float
    """Length of the path since the start."""
    was_carried: bool
    """Whether a person carried it in the last tick."""

    @property
    def pose(self) -> Pose2D:
        """Arena frame; yaw in [−π, π]."""


class RobotBody:
    """One robot in the space of the arena, as of the last tick; `RobotBodies` moves it.

    Args:
        space: space to which its body and shape are added.
        wheels: the three of them, as they truly are.
        start: pose in the arena frame.
        radius_m: of the round hull.

    """

    def __init__(self, space: pymunk.Space, wheels: Wheels, start: Pose2D, radius_m: float) -> None:
        self.wheels = wheels
        self.radius_m = radius_m
        self.x_m, self.y_m, self.yaw_rad = start.x_m, start.y_m, start.yaw_rad
        """Pose in the arena frame; the yaw is not wrapped."""
        self.forward_m, self.left_m, self.turned_rad = 0.0, 0.0, 0.0
        """Displacement of the last tick in the body frame, at the yaw halfway."""
        self.contacts_rad: list[float] = []
        """Contacts of the hull in the last tick: directions in the arena frame, from the centre."""
        self.distance_m = 0.0
        """Path length since the start."""
        self.was_carried = False
        """Whether `carry_to` was called since the last tick."""
        self.body = pymunk.Body(MASS_KG, pymunk.moment_for_circle(MASS_KG, 0.0, radius_m))
        self.body.position = start.x_m, start.y_m
        self.body.angle = start.yaw_rad
        self.shape = pymunk.Circle(self.body, radius_m)
        self.shape.collision_type = ROBOT_COLLISION
        self.shape.friction = FRICTION
        space.add(self.body, self.shape)

    @property
    def pose(self) -> Pose2D:
        """Its pose, arena frame; yaw in [−π, π]."""
        return Pose2D(self.x_m, self.y_m, math.remainder(self.yaw_rad, math.tau))

    @property
    def place_m(self) -> tuple[float, float]:
        """Its current pose, also in the middle of a step of the space; arena frame."""
        x_m, y_m = self.body.position
        return x_m, y_m

    def carry_to(self, pose: Pose2D) -> None:
        """A person picks the robot up and puts it down here, at rest: its wheels do not turn."""
        self.x_m, self.y_m, self.yaw_rad = pose.x_m, pose.y_m, pose.yaw_rad
        self.body.position = pose.x_m, pose.y_m
        self.body.angle = pose.yaw_rad
        self.body.velocity = 0.0, 0.0
        self.body.angular_velocity = 0.0
        self.was_carried = True


class RobotBodies:
    """All robots of a space, moved together; rows are in the order of `bodies`.

    A tick is `drive()`, then the step of the space, then `roll()`.

    Args:
        space: has walls and these bodies; none must be added afterwards.
        bodies: in the order in which they were added.
        tick_s: length of a tick.
        others: bodies that were added after them, and move by `other_velocities`.

    Raises:
        ValueError: the space has other bodies, or has them in another order.

    """

    def __init__(
        self,
        space: pymunk.Space,
        bodies: Sequence[RobotBody],
        tick_s: float,
        others: Sequence[pymunk.Body] = (),
    ) -> None:
        self.bodies = bodies
        self.wanted_rad_s = np.zeros((len(bodies), 3))
        """(N, 3) speeds at which the motors hold the wheels."""
        self.turns_rad = np.zeros((len(bodies), 3))
        """(N, 3) how far each wheel has turned since the start."""
        self.state = np.zeros(len(bodies), STATE)
        """(N,) poses and displacements; see `STATE`."""
        self.touched: list[RobotBody] = []
        """Bodies with contacts in the last tick, once for each contact."""
        self._space = space
        self._tick_s = tick_s
        self._speed_change_m_s = ACCELERATION_MAX_M_S2 * tick_s
        self._yaw_rate_change_rad_s = YAW_ACCELERATION_MAX_RAD_S2 * tick_s
        self._wheels = np.zeros(len(bodies), WHEELS)
        for row, body in enumerate(bodies):
            self._wheels[row] = body.wheels.row
            self.state[row] = (body.x_m, body.y_m, body.yaw_rad, 0.0, 0.0, 0.0, 0.0)
        self._normals = np.zeros((len(bodies), 2 * DRAWS))
        self._used = np.zeros(len(bodies), np.int64)
        self._draw_normals(first=True)
        rows = self._rows(others)
        self._motion, self._velocities = np.zeros((rows, MOTION)), np.zeros((rows, 3))
        self.other_velocities = self._velocities[len(bodies) : len(bodies) + len(others)]
        """(K, 3) rates of x, y and yaw of the other bodies, set by their owner before `drive()`."""
        self._poses_buffer, self._velocities_buffer = pymunk.batch.Buffer(), pymunk.batch.Buffer()
        self._velocities_buffer.set_float_buf(self._velocities)  # read in place; the output needs its own buffer

    def drive(self) -> None:
        """Set the bodies' velocities, as near to those of their wheels as the acceleration allows in a tick."""
        for body in self.touched:
            body.contacts_rad.clear()
        self.touched.clear()
        for row, body in enumerate(self.bodies):
            if body.was_carried:
                body.was_carried = False
                self.state[row]["x_m"], self.state[row]["y_m"] = body.x_m, body.y_m
                self.state[row]["yaw_rad"] = body.yaw_rad
                self._motion[row, 3:] = 0.0
        drive(
            self.state,
            self._motion,
            self._wheels,
            self.wanted_rad_s,
            self._velocities,
            self._tick_s,
            self._speed_change_m_s,
            self._yaw_rate_change_rad_s,
        )
        pymunk.batch.set_space_bodies(self._space, _RATES, self._velocities_buffer)

    def roll(self) -> None:
        """Update the bodies after the step of the space: pose, path length and wheels."""
        self._poses_buffer.clear()
        pymunk.batch.get_space_bodies(self._space, _POSE_AND_RATES, self._poses_buffer)
        self._motion = np.frombuffer(self._poses_buffer.float_buf()).reshape(-1, MOTION)
        if roll(self.state, self._motion, self._wheels, self.turns_rad, self._normals, self._used, DRAWS):
            self._draw_normals()
        for body, row in zip(self.bodies, self.state.tolist(), strict=True):
            body.x_m, body.y_m, body.yaw_rad, body.forward_m, body.left_m, body.turned_rad, body.distance_m = row

    def _draw_normals(self, *, first: bool = False) -> None:
        for row, body in enumerate(self.bodies):
            if body.wheels.is_random and (first or self._used[row] >= DRAWS):
                normals = self._normals[row]
                normals[:DRAWS] = body.wheels.draw_normals() if first else normals[DRAWS:]
                normals[DRAWS:] = body.wheels.draw_normals()
                self._used[row] = 0 if first else self._used[row] - DRAWS

    def _rows(self, others: Sequence[pymunk.Body]) -> int:
        """Bodies in the space: the robots', the others, and after them that of the walls, which stands."""
        found = pymunk.batch.Buffer()
        pymunk.batch.get_space_bodies(self._space, BodyFields.BODY_ID, found)
        ids = list(memoryview(found.int_buf()).cast("P"))
        known = [body.body.id for body in self.bodies] + [body.id for body in others]
        if ids[: len(known)] != known or set(ids[len(known) :]) - {self._space.static_body.id}:
            raise ValueError("expected the space to have walls and these robots' bodies, in this order, and no others")
        return len(ids)


class CollisionCounter:
    """Counts for each robot how often it began to touch a wall or another robot.

    It also notes on the bodies where they are touched. All walls are one partner, thus sliding from one wall's shape to
    the next is no new collision. `count[i]` is that of the i-th robot. `movers` are shapes of other moving bodies.
    """

    def __init__(
        self, space: pymunk.Space, robots: RobotBodies, tick_s: float, movers: Sequence[pymunk.Shape] = ()
    ) -> None:
        self.count = [0] * len(robots.bodies)
        self.tick = 0
        """Its owner moves it on."""
        self._robots = robots
        self._index: dict[pymunk.Shape, int] = {robot.shape: index for index, robot in enumerate(robots.bodies)}
        self._index |= {shape: _WALL - number for number, shape in enumerate(movers, 1)}
        self._touching: dict[tuple[int, int], int] = {}
        self._parted_tick: dict[tuple[int, int], int] = {}
        self._apart_ticks = round(APART_S / tick_s)
        for other in (ROBOT_COLLISION, WALL_COLLISION, *([MOVER_COLLISION] if movers else [])):
            space.on_collision(
                ROBOT_COLLISION, other, begin=self._begin, separate=self._separate, post_solve=self._touch
            )

    def _begin(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        pair = self._pair(arbiter)
        touching = self._touching.get(pair, 0)
        self._touching[pair] = touching + 1
        if touching or self.tick - self._parted_tick.get(pair, -self._apart_ticks) < self._apart_ticks:
            return
        for index in pair:
            if index >= 0:
                self.count[index] += 1

    def _separate(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        pair = self._pair(arbiter)
        self._touching[pair] -= 1
        self._parted_tick[pair] = self.tick

    def _touch(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        for shape in arbiter.shapes:
            index = self._index.get(shape, _WALL)
            if index >= 0:
                robot = self._robots.bodies[index]
                self._robots.touched.append(robot)
                x_m, y_m = robot.place_m
                for contact in arbiter.contact_point_set.points:
                    point = contact.point_a
                    robot.contacts_rad.append(math.atan2(point.y - y_m, point.x - x_m))

    def _pair(self, arbiter: pymunk.Arbiter) -> tuple[int, int]:
        one, other = (self._index.get(shape, _WALL) for shape in arbiter.shapes)
        return min(one, other), max(one, other)


_WALL = -1
