"""The field that the motes sense: a heat map between their readings."""

from collections import Counter

import numpy as np
import viser
from numpy.typing import NDArray

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing.palette import HEAT

FIELD_Z_M = 0.01
CELLS = 96
"""Along the longer side."""
REACH_M = 5.0
"""Farther than this from every mote nothing is said."""
ALPHA = 150


class FieldLayer(Layer):
    """What lies between the readings of one quantity, by inverse distances; nothing where no mote is near."""

    name, label, period_s, shown_at_first = "field", "Heat map", 2.0, False

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self.range: tuple[str, float, float] | None = None
        """Quantity, lowest and highest value of what is drawn; for a legend."""
        self._handle: viser.ImageHandle | None = None
        self._extent: tuple[float, float, float, float] | None = None

    def _draw(self, view: TeamView, now_s: float) -> None:
        bounds = view.map.known_bounds_m()
        quantity = most_read(view)
        if bounds is None or quantity is None:
            self.range = None
            if self._handle is not None:
                self._handle.remove()
                self._handle, self._extent = None, None
            return
        points, values = readings_of(view, quantity)
        self.range = (quantity, float(values.min()), float(values.max()))
        x_min, y_min, x_max, y_max = bounds
        cell_m = max(x_max - x_min, y_max - y_min) / CELLS
        shape = (max(1, round((y_max - y_min) / cell_m)), max(1, round((x_max - x_min) / cell_m)))
        picture = heat_picture(points, values, bounds, shape)
        if self._handle is not None and bounds == self._extent:
            self._handle.image = picture
            return
        self._extent = bounds
        self._handle = self.scene.add_image(
            self.node("picture"),
            picture,
            x_max - x_min,
            y_max - y_min,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            position=((x_min + x_max) / 2, (y_min + y_max) / 2, FIELD_Z_M),
        )


def most_read(view: TeamView) -> str | None:
    """The quantity that most motes with a place have told; None if there is none."""
    counts = Counter(
        quantity for mote in view.motes.values() if mote.place is not None for quantity in sorted(mote.readings)
    )
    return max(counts, key=lambda quantity: (counts[quantity], quantity)) if counts else None


def readings_of(view: TeamView, quantity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (N, 2), metres, arena frame, and the last values (N,) of one quantity, finite ones only."""
    told = [
        (mote.place.x_m, mote.place.y_m, mote.readings[quantity].value)
        for mote in view.motes.values()
        if mote.place is not None and quantity in mote.readings
    ]
    table = np.array(told, np.float64).reshape(-1, 3)
    return table[:, :2], np.nan_to_num(table[:, 2], nan=0.0, posinf=0.0, neginf=0.0)


def heat_picture(
    points: NDArray[np.float64],
    values: NDArray[np.float64],
    bounds: tuple[float, float, float, float],
    shape: tuple[int, int],
) -> NDArray[np.uint8]:
    """RGBA image uint8 (rows, columns, 4), row 0 at the lowest y, by Shepard's inverse distance weighting, power 2."""
    x_min, y_min, x_max, y_max = bounds
    x_m = x_min + (np.arange(shape[1]) + 0.5) * (x_max - x_min) / shape[1]
    y_m = y_min + (np.arange(shape[0]) + 0.5) * (y_max - y_min) / shape[0]
    total, weights = np.zeros(shape), np.zeros(shape)
    nearest = np.full(shape, np.inf)
    for (point_x, point_y), value in zip(points, values, strict=True):
        squared = (x_m[None, :] - point_x) ** 2 + (y_m[:, None] - point_y) ** 2
        np.minimum(nearest, squared, out=nearest)
        weight = 1.0 / (squared + 0.05)
        total += weight * value
        weights += weight
    low, high = float(values.min()), float(values.max())
    share = np.clip((total / weights - low) / (high - low if high > low else 1.0), 0.0, 1.0)
    steps = np.array(HEAT, np.float64)
    at = share * (len(steps) - 1)
    picture = np.empty((*shape, 4), np.uint8)
    for channel in range(3):
        picture[:, :, channel] = np.interp(at, np.arange(len(steps)), steps[:, channel])
    picture[:, :, 3] = np.where(nearest <= REACH_M**2, ALPHA, 0)
    return picture
