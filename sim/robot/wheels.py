"""Wheels that are not quite what the robot takes them for: systematic errors, and slip.

Borenstein and Feng (*Measurement and Correction of Systematic Odometry Errors in Mobile Robots*, IEEE Transactions on
Robotics and Automation 12(6), 1996) tell systematic errors of odometry, of which unequal wheel diameters and an
uncertain wheelbase are the dominant ones, from non-systematic ones such as slip. Both are here for a base with three
omni wheels.
"""

import math
from typing import Self

import msgspec
import numpy as np

from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.navigation.omni_drive import WHEEL_ANGLES_RAD, OmniBase
from robrain.sim.spec_checks import check_within

DRAWS = 256
"""Random numbers drawn at a time; one by one they cost ten times as much."""


class WheelSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot.wheels]`: errors of the wheels; the default is none.

    Raises ValueError for impossible values.
    """

    radius_sigma: float = 0.0
    """Relative error of each wheel's radius: standard deviation, drawn once for each wheel."""
    base_sigma: float = 0.0
    """Relative error of the wheels' distance from the centre: standard deviation, drawn once for each robot."""
    slip: float = 0.0
    """Share of each wheel's turn that does not move the robot."""
    slip_sigma_m_per_sqrt_m: float = 0.0
    """Random slip along a wheel's tread: standard deviation of its way, in metres, after a metre of it."""
    lateral_slip: float = 0.0
    """Way along the tread for each metre along the axle, by friction of the rollers."""
    lateral_sigma_m_per_sqrt_m: float = 0.0
    """Random slip along the tread while the wheel moves along its axle, after a metre of that."""

    def __post_init__(self) -> None:
        sigmas = ("radius_sigma", "base_sigma", "slip_sigma_m_per_sqrt_m", "lateral_sigma_m_per_sqrt_m")
        check_within(self, 0, 0.2, *sigmas)
        check_within(self, -0.5, 0.5, "slip", "lateral_slip")

    @property
    def is_exact(self) -> bool:
        """Whether the wheels are what the robot takes them for, and never slip."""
        return self == WheelSpec()


class Wheels:
    """The true wheels of one robot: what way their turns make, and how far they turn on a way.

    Args:
        nominal: what the robot takes the base for.
        true: what it is.
        radius_share: true radius of each wheel over that of `true`.
        spec: how they slip.
        rng: draws the slip.

    """

    def __init__(
        self,
        nominal: OmniBase,
        true: OmniBase,
        radius_share: tuple[float, float, float],
        spec: WheelSpec,
        rng: np.random.Generator,
    ) -> None:
        self.nominal = nominal
        self.true = true
        self.radius_share = radius_share
        self._spec = spec
        self._rng = rng
        self._draws: list[float] = []
        self._way_per_turn = tuple(share * (1.0 - spec.slip) for share in radius_share)
        """Way of each wheel over that of an exact one."""
        self._is_random = spec.slip_sigma_m_per_sqrt_m > 0 or spec.lateral_sigma_m_per_sqrt_m > 0

    @classmethod
    def draw(cls, nominal: OmniBase, spec: WheelSpec, rng: np.random.Generator) -> Self:
        """The wheels of one robot; takes four normal numbers from `rng`, and later those of the slip."""
        radius_errors = spec.radius_sigma * rng.standard_normal(3)
        distance_m = nominal.wheel_distance_m * (1.0 + spec.base_sigma * float(rng.standard_normal()))
        true = msgspec.structs.replace(nominal, wheel_distance_m=distance_m)
        first, second, third = (1.0 + float(error) for error in radius_errors)
        return cls(nominal, true, (first, second, third), spec, rng)

    def twist(self, wheel_1_rad_s: float, wheel_2_rad_s: float, wheel_3_rad_s: float) -> Twist2D:
        """The body's velocity at these speeds of the wheels."""
        first, second, third = self._way_per_turn
        return self.true.twist(first * wheel_1_rad_s, second * wheel_2_rad_s, third * wheel_3_rad_s)

    def turns_rad(self, displacement: Twist2D) -> tuple[float, float, float]:
        """How far the wheels turn while the body moves by this (m, m, rad), slip included."""
        first, second, third = self.true.wheel_speeds_rad_s(displacement)
        if self._spec.lateral_slip or self._is_random:
            slips = self._slips_rad(displacement, (first, second, third))
            first, second, third = first + slips[0], second + slips[1], third + slips[2]
        one, other, last = self._way_per_turn
        return first / one, second / other, third / last

    def _slips_rad(self, displacement: Twist2D, turns_rad: tuple[float, float, float]) -> list[float]:
        spec, radius_m = self._spec, self.true.wheel_radius_m
        forward_m, left_m = displacement.forward_m_s, displacement.left_m_s
        slips = []
        for wheel, turn_rad in enumerate(turns_rad):
            axial_m = _AXLES[wheel][0] * forward_m + _AXLES[wheel][1] * left_m
            slip_m = spec.lateral_slip * axial_m
            if self._is_random:
                variance_m2 = spec.slip_sigma_m_per_sqrt_m**2 * abs(
                    turn_rad
                ) * radius_m + spec.lateral_sigma_m_per_sqrt_m**2 * abs(
                    axial_m
                )  # a random walk: the variance grows with the way
                if variance_m2 > 0:
                    slip_m += math.sqrt(variance_m2) * self._normal()
            slips.append(slip_m / radius_m)
        return slips

    def _normal(self) -> float:
        if not self._draws:
            self._draws = self._rng.standard_normal(DRAWS).tolist()
        return self._draws.pop()


_AXLES = tuple((math.cos(angle), math.sin(angle)) for angle in WHEEL_ANGLES_RAD)
