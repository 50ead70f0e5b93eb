"""The field that motes sense: a level over the whole floor, and Gaussian plumes that the air carries along.

A plume keeps its shape and moves with its own velocity relative to the common wind. This is advection without
diffusion, as from a source that renews the substance. A plume that leaves the floor on one side returns on the other.
All figures are chosen.
"""

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NotNegative, Positive
from robrain.protocol.tinyos.payloads import Quantity
from robrain.sim.maps.floor_plan import FloorPlan

MAX_PLUMES = 64
MARGIN_WIDTHS = 3.0
"""Distance outside of the floor, in plume widths, at which a plume moves to the other side; the jump is invisible
there.
"""
OWN_SHARE = 0.5
"""A plume's own speed is up to so much of the wind's."""


class Levels(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Values of one quantity. Raises ValueError where the noise is negative."""

    base: float
    """Value away from all plumes."""
    plume: float
    """Level that a plume adds at its centre."""
    noise: NotNegative
    """Standard deviation of one reading."""


class FieldSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[field]`: the quantities that motes measure, and plumes that move over the floor.

    Raises ValueError where there are too many plumes, or a width or speed without sense.
    """

    plumes: Annotated[int, Meta(ge=0, le=MAX_PLUMES)] = 3
    """Number of plumes."""
    width_m: Positive = 3.0
    """Standard deviation of a plume's shape."""
    wind_m_s: NotNegative = 0.05
    """Speed of the plumes; the direction is drawn from the seed."""
    temperature: Levels = Levels(base=20.0, plume=9.0, noise=0.1)
    """°C"""
    light: Levels = Levels(base=200.0, plume=300.0, noise=5.0)
    """lux"""
    humidity: Levels = Levels(base=40.0, plume=25.0, noise=1.0)
    """% relative"""

    def levels(self, quantity: Quantity) -> Levels:
        """Those of one quantity."""
        match quantity:
            case Quantity.TEMPERATURE:
                return self.temperature
            case Quantity.LIGHT:
                return self.light
            case Quantity.HUMIDITY:
                return self.humidity


class Plume(msgspec.Struct, frozen=True):
    """Place of a plume at time 0, arena frame, and its motion."""

    x_m: float
    y_m: float
    x_m_s: float
    y_m_s: float


class SimulatedField:
    """The field of one run.

    Args:
        spec: heights and widths of plumes.
        plumes: which there are.
        corner: lowest x and y that a plume's middle can have.
        size_m: width and height beyond which it turns up on the other side.

    """

    def __init__(self, spec: FieldSpec, plumes: list[Plume], corner: Point2D, size_m: tuple[float, float]) -> None:
        self.spec = spec
        self._plumes = plumes
        self._corner = corner
        self._size_m = size_m

    @classmethod
    def draw(cls, spec: FieldSpec, plan: FloorPlan, rng: np.random.Generator) -> "SimulatedField":
        """Plumes at random places of a floor, carried by a wind of random direction."""
        margin_m = MARGIN_WIDTHS * spec.width_m
        width_m, height_m = plan.size_m
        corner = Point2D(plan.origin_x_m - margin_m, plan.origin_y_m - margin_m)
        heading_rad = rng.uniform(-np.pi, np.pi)
        plumes = []
        for _ in range(spec.plumes):
            x_m = plan.origin_x_m + rng.uniform(0.0, width_m)
            y_m = plan.origin_y_m + rng.uniform(0.0, height_m)
            own_rad, own_m_s = rng.uniform(-np.pi, np.pi), OWN_SHARE * spec.wind_m_s * rng.random()
            plumes.append(
                Plume(
                    x_m,
                    y_m,
                    spec.wind_m_s * math.cos(heading_rad) + own_m_s * math.cos(own_rad),
                    spec.wind_m_s * math.sin(heading_rad) + own_m_s * math.sin(own_rad),
                )
            )
        return cls(spec, plumes, corner, (width_m + 2.0 * margin_m, height_m + 2.0 * margin_m))

    def value(self, quantity: Quantity, place: Point2D, time_s: float) -> float:
        """The true value at a place of the arena frame, after so much simulated time."""
        levels = self.spec.levels(quantity)
        per_width = 1.0 / self.spec.width_m
        width_m, height_m = self._size_m
        excess = 0.0
        for plume in self._plumes:
            x_m = self._corner.x_m + (plume.x_m + plume.x_m_s * time_s - self._corner.x_m) % width_m
            y_m = self._corner.y_m + (plume.y_m + plume.y_m_s * time_s - self._corner.y_m) % height_m
            distance = math.hypot(place.x_m - x_m, place.y_m - y_m) * per_width
            excess += math.exp(-0.5 * distance * distance)
        return levels.base + levels.plume * excess
