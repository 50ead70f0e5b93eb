"""Wheels that differ from the robot's model of them: systematic errors, and slip.

Borenstein and Feng distinguish systematic errors of odometry from non-systematic ones such as slip. Unequal wheel
diameters and an uncertain wheelbase dominate the systematic errors. Source: *Measurement and Correction of Systematic
Odometry Errors in Mobile Robots*, IEEE Transactions on Robotics and Automation 12(6), 1996. Both are here for a base
with three omni wheels.
"""

from typing import Annotated, Self

import msgspec
import numpy as np
from msgspec import Meta

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.model.checked import Checked

DRAWS = 256
"""Random numbers drawn at a time; one by one they cost ten times as much."""


class WheelSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot.wheels]`: errors of the wheels; the default is none.

    Raises ValueError for impossible values.
    """

    radius_sigma: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Relative error of each wheel's radius: standard deviation, drawn once for each wheel."""
    base_sigma: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Relative error of the wheels' distance from the centre: standard deviation, drawn once for each robot."""
    slip: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.0
    """Share of each wheel's turn that does not move the robot."""
    slip_sigma_m_per_sqrt_m: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Random slip along a wheel's tread: standard deviation of its path length, in metres, after a metre of it."""
    lateral_slip: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.0
    """Path along the tread for each metre along the axle, by friction of the rollers."""
    lateral_sigma_m_per_sqrt_m: Annotated[float, Meta(ge=0, le=0.2)] = 0.0
    """Random slip along the tread while the wheel moves along its axle, after a metre of that."""

    @property
    def is_exact(self) -> bool:
        """Whether the wheels equal the robot's model of them, and never slip."""
        return self == WheelSpec()


class Wheels:
    """The true wheels of one robot.

    Args:
        true: the true base.
        radius_share: true radius of each wheel over that of `true`.
        spec: their slip.
        rng: draws the slip.

    """

    def __init__(
        self,
        true: OmniBase,
        radius_share: tuple[float, float, float],
        spec: WheelSpec,
        rng: np.random.Generator,
    ) -> None:
        self.true = true
        self.radius_share = radius_share
        self._rng = rng
        slip_m2_per_m, lateral_m2_per_m = spec.slip_sigma_m_per_sqrt_m**2, spec.lateral_sigma_m_per_sqrt_m**2
        path_per_turn = tuple(share * (1.0 - spec.slip) for share in radius_share)  # over that of exact wheels
        bases = true.wheel_radius_m, true.wheel_distance_m
        self.row = (*bases, path_per_turn, spec.lateral_slip, slip_m2_per_m, lateral_m2_per_m)
        """Fields of `WHEELS` in `sim/robot/robot_body.py`."""
        self.is_random = slip_m2_per_m > 0 or lateral_m2_per_m > 0

    @classmethod
    def draw(cls, nominal: OmniBase, spec: WheelSpec, rng: np.random.Generator) -> Self:
        """The wheels of one robot; draws four normal numbers from `rng`, and later those of the slip."""
        radius_errors = spec.radius_sigma * rng.standard_normal(3)
        distance_m = nominal.wheel_distance_m * (1.0 + spec.base_sigma * float(rng.standard_normal()))
        true = msgspec.structs.replace(nominal, wheel_distance_m=distance_m)
        first, second, third = (1.0 + float(error) for error in radius_errors)
        return cls(true, (first, second, third), spec, rng)

    def draw_normals(self) -> list[float]:
        """The next `DRAWS` normal random numbers of the slip, in the order of their use."""
        drawn: list[float] = self._rng.standard_normal(DRAWS)[::-1].tolist()
        return drawn
