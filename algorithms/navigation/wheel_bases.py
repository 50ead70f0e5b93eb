"""Kinematics of wheeled bases that are described by their geometry: omni, mecanum, differential, Ackermann.

Each wheel i drives along a fixed line. Its speed is r·ω_i = a_i·v_x + b_i·v_y + c_i·ω for the body's velocity (v_x,
v_y, ω), frame of REP 103. Source: Siegwart, Nourbakhsh, Scaramuzza, Introduction to Autonomous Mobile Robots, 2nd ed.,
section 3.2. The body's velocity from the wheels is the least-squares solution. Motion that no wheel can drive, such as
the sideways motion of a differential base, is 0 in it.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import repeat
from operator import mul
from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.ranges import Positive, PositiveInt

WHEEL_ANGLES_RAD = (math.radians(60.0), math.radians(180.0), math.radians(300.0))
TANGENTS = tuple((-math.sin(angle), math.cos(angle)) for angle in WHEEL_ANGLES_RAD)
"""Unit vectors along which the wheels drive, robot's frame."""
WHEELS_MAX = 8
Rows = tuple[tuple[float, float, float], ...]


class DescribedBase(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True, tag_field="type"):
    """Common part of all described bases.

    Lengths are in metres, wheels count 1, 2, … in the order that each type says.

    Raises ValueError if a size is not above 0.
    """

    wheel_radius_m: Positive
    encoder_ticks_per_turn: PositiveInt
    """Counts of an encoder for a turn of its wheel, gears included."""

    @property
    def rows(self) -> Rows:
        """(a, b, c) of each wheel."""
        raise NotImplementedError

    @property
    def is_holonomic(self) -> bool:
        """Whether it can drive sideways."""
        return any(row[1] for row in self.rows)

    @property
    def turn_radius_min_m(self) -> float:
        """Radius of the tightest turn; 0 for a base that turns on the spot."""
        return 0.0

    @property
    def rad_per_tick(self) -> float:
        """Turn of a wheel between two encoder ticks."""
        return 2 * math.pi / self.encoder_ticks_per_turn

    @property
    def wheels(self) -> int:
        """Number of wheels with an encoder."""
        return len(self.rows)

    def wheel_speeds_rad_s(self, twist: Twist2D) -> tuple[float, ...]:
        """Inverse kinematics: wheel speeds for a velocity in the body frame."""
        x, y, turn, radius = twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s, self.wheel_radius_m
        return tuple([(a * x + b * y + c * turn) / radius for a, b, c in self.rows])

    def commands(self, twist: Twist2D, wheel_speed_max_rad_s: float) -> tuple[float, ...]:
        """Commands for the motor controller: wheel speeds, slower in proportion if one were too fast."""
        wanted = self.wheel_speeds_rad_s(twist)
        share = wheel_speed_max_rad_s / max(wheel_speed_max_rad_s, *map(abs, wanted))
        return tuple(map(mul, repeat(share), wanted))

    def twist(self, *wheels_rad_s: float) -> Twist2D:
        """Forward kinematics: velocity in the body frame from wheel speeds (also turns → displacement)."""
        radius = self.wheel_radius_m
        forward = left = turn = 0.0
        for speed, (x, y, w) in zip(wheels_rad_s, self._inverse, strict=True):
            forward, left, turn = forward + x * speed, left + y * speed, turn + w * speed
        return Twist2D(radius * forward, radius * left, radius * turn)

    def commanded(self, values: Sequence[float]) -> Twist2D:
        """Motion of the base under these `commands`."""
        return self.twist(*values)

    @cached_property
    def _inverse(self) -> Rows:
        """For each wheel its share of (v_x, v_y, ω): the pseudo-inverse of `rows`, transposed."""
        return pseudo_inverse(self.rows)


class OmniBase(DescribedBase, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="omni3"):
    """Three omni wheels at `WHEEL_ANGLES_RAD`.

    The defaults are chosen in the manner of the Robertino; no data sheet was found.
    """

    wheel_radius_m: Positive = 0.04
    wheel_distance_m: Positive = 0.155
    """From the robot's centre to a wheel."""
    encoder_ticks_per_turn: PositiveInt = 4096

    @cached_property
    def rows(self) -> Rows:
        """As in DescribedBase."""
        return tuple([(x, y, self.wheel_distance_m) for x, y in TANGENTS])

    def wheel_speeds_rad_s(self, twist: Twist2D) -> tuple[float, float, float]:
        """As in DescribedBase."""
        (x1, y1, _), (x2, y2, _), (x3, y3, _) = self.rows
        vx, vy, turning = twist.forward_m_s, twist.left_m_s, self.wheel_distance_m * twist.yaw_rad_s
        radius = self.wheel_radius_m
        first, second, third = x1 * vx + y1 * vy, x2 * vx + y2 * vy, x3 * vx + y3 * vy
        return (first + turning) / radius, (second + turning) / radius, (third + turning) / radius

    def twist(self, *wheels_rad_s: float) -> Twist2D:
        """As in DescribedBase: the three tangents add up to zero, so that the inverse is 2/3 of the transpose."""
        radius, (first, second, third) = self.wheel_radius_m, wheels_rad_s
        v1, v2, v3 = radius * first, radius * second, radius * third
        return Twist2D(
            (2 / 3) * (TANGENTS[0][0] * v1 + TANGENTS[1][0] * v2 + TANGENTS[2][0] * v3),
            (2 / 3) * (TANGENTS[0][1] * v1 + TANGENTS[1][1] * v2 + TANGENTS[2][1] * v3),
            (v1 + v2 + v3) / (3 * self.wheel_distance_m),
        )


class Omni(DescribedBase, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="omni"):
    """Omni wheels on a circle, each driving along its tangent, counter-clockwise if positive."""

    wheel_distance_m: Positive
    """From the robot's centre to each wheel."""
    wheel_angles_deg: Annotated[tuple[float, ...], Meta(min_length=3, max_length=WHEELS_MAX)]
    """Directions of the wheels from the robot's x axis, counter-clockwise; (45, 135, 225, 315) for four."""

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            pseudo_inverse(self.rows)
        except ValueError:
            raise ValueError("wheel_angles_deg: these wheels cannot drive in all directions") from None

    @property
    def rows(self) -> Rows:
        """As in DescribedBase."""
        angles = [math.radians(angle) for angle in self.wheel_angles_deg]
        return tuple([(-math.sin(angle), math.cos(angle), self.wheel_distance_m) for angle in angles])


class Mecanum(DescribedBase, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="mecanum"):
    """Four mecanum wheels whose rollers make an X seen from above: front left, front right, rear left, rear right."""

    wheelbase_m: Positive
    """From front to rear axle."""
    track_m: Positive
    """From left to right wheels."""

    @property
    def rows(self) -> Rows:
        """As in DescribedBase."""
        reach = 0.5 * (self.wheelbase_m + self.track_m)
        return ((1.0, -1.0, -reach), (1.0, 1.0, reach), (1.0, 1.0, -reach), (1.0, -1.0, reach))


class Differential(DescribedBase, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="differential"):
    """Two driven wheels on one axle: left, right; or four, if those of a side turn together."""

    track_m: Positive
    """From left to right wheel; of a base with four wheels that skid, the effective one (UMBmark finds it)."""
    wheels_per_side: Annotated[int, Meta(ge=1, le=WHEELS_MAX // 2)] = 1
    """All left wheels come before the right ones."""
    wheel_radius_ratio: Positive = 1.0
    """Radius of the right wheels by that of the left ones (UMBmark finds it); `wheel_radius_m` is the mean of both."""

    @property
    def rows(self) -> Rows:
        """As in DescribedBase."""
        # Borenstein and Feng 1996, section V: the radii are 2 / (E_d + 1) and 2 / (1 / E_d + 1) times their mean.
        ratio, half_track_m = self.wheel_radius_ratio, 0.5 * self.track_m
        by_left, by_right = 0.5 * (ratio + 1.0), 0.5 * (1.0 / ratio + 1.0)
        left, right = (by_left, 0.0, -by_left * half_track_m), (by_right, 0.0, by_right * half_track_m)
        return (left,) * self.wheels_per_side + (right,) * self.wheels_per_side


class Ackermann(DescribedBase, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="ackermann"):
    """A car: it is commanded by the rear wheels' speed and a steering angle; the rear wheels, left and right, count.

    The commands follow the bicycle model: tan δ = L·ω / v_x. They are the speed of the rear axle (rad/s of a wheel) and
    the steering angle (rad, positive to the left).
    """

    wheelbase_m: Positive
    track_m: Positive
    """Between the rear wheels."""
    steering_max_rad: Annotated[float, Meta(gt=0.0, lt=1.5)]

    @property
    def rows(self) -> Rows:
        """As in DescribedBase, of the rear wheels."""
        return ((1.0, 0.0, -0.5 * self.track_m), (1.0, 0.0, 0.5 * self.track_m))

    @property
    def turn_radius_min_m(self) -> float:
        """Radius of the tightest turn of the rear axle's middle."""
        return self.wheelbase_m / math.tan(self.steering_max_rad)

    def commands(self, twist: Twist2D, wheel_speed_max_rad_s: float) -> tuple[float, ...]:
        """Rear wheel speed and steering angle; a turn without a forward motion cannot be driven, and gives none."""
        speed = max(-wheel_speed_max_rad_s, min(wheel_speed_max_rad_s, twist.forward_m_s / self.wheel_radius_m))
        if twist.forward_m_s == 0.0:
            return (0.0, 0.0)
        steering = math.atan(self.wheelbase_m * twist.yaw_rad_s / twist.forward_m_s)
        return (speed, max(-self.steering_max_rad, min(self.steering_max_rad, steering)))

    def commanded(self, values: Sequence[float]) -> Twist2D:
        """As in DescribedBase; it does not steer further than it can."""
        forward_m_s, steering = values[0] * self.wheel_radius_m, values[1]
        steering = max(-self.steering_max_rad, min(self.steering_max_rad, steering))
        return Twist2D(forward_m_s, 0.0, forward_m_s * math.tan(steering) / self.wheelbase_m)


WheelBase = OmniBase | Omni | Mecanum | Differential | Ackermann


def pseudo_inverse(rows: Rows) -> Rows:
    """The transposed Moore–Penrose inverse of n rows (a, b, c): (JᵀJ)⁻¹Jᵀ, without a column that is all 0.

    Raises:
        ValueError: the other columns are not independent.

    """
    used = [column for column in range(3) if any(row[column] for row in rows)]
    size = len(used)
    normal = [[math.fsum(row[i] * row[j] for row in rows) for j in used] for i in used]
    inverse = [[float(i == j) for j in range(size)] for i in range(size)]
    for pivot in range(size):  # Gauss–Jordan; the matrix is symmetric and positive definite
        best = max(range(pivot, size), key=lambda index: abs(normal[index][pivot]))
        share = normal[best][pivot]
        if abs(share) < 1e-12:
            raise ValueError("the wheels' directions are not independent")
        factors = [line[pivot] for line in normal]
        factors[best], factors[pivot] = factors[pivot], factors[best]
        for matrix in (normal, inverse):
            matrix[pivot], matrix[best] = matrix[best], matrix[pivot]
            matrix[pivot] = [value / share for value in matrix[pivot]]
            for index, factor in enumerate(factors):
                if index != pivot and factor:
                    pairs = zip(matrix[index], matrix[pivot], strict=True)
                    matrix[index] = [value - factor * other for value, other in pairs]
    found = []
    for wheel in rows:
        values = [0.0, 0.0, 0.0]
        for i, column in enumerate(used):
            values[column] = math.fsum(inverse[i][j] * wheel[other] for j, other in enumerate(used))
        found.append((values[0], values[1], values[2]))
    return tuple(found)
