"""Objects on the floor: the map, walls, the field that motes sense, and unexplored regions."""

from collections import Counter

import numpy as np
import viser
from numpy.typing import NDArray

from robrain.dashboard.layers.layer import LabelledLayer, Layer, MeshLayer
from robrain.dashboard.scene.camera import Bounds, bounds_of
from robrain.dashboard.scene.merged_meshes import by_color, copies
from robrain.dashboard.scene.meshes import Mesh, cube, diamond
from robrain.dashboard.scene.scene_nodes import FloorPicture, rows
from robrain.dashboard.state.shown_team import FloorVersion, ShownTeam
from robrain.protocol.messages.maps.map_messages import LeftKind, RegionLeft
from robrain.protocol.model.geometry import Point2D
from robrain.recording.drawing.palette import BAD, FREE, HEAT, OCCUPIED, UNKNOWN, WALL, WARNING, Rgb

FLOOR_Z_M, FIELD_Z_M = -0.01, 0.01
WALL_HEIGHT_M = 0.35
"""Lower than a real wall, so that a robot behind one is still visible."""
TEXTURE_PX = 2048
"""Cells are magnified up to this size, because the browser smooths between pixels."""
MAGNIFIED = 6
CELLS = 96
"""Cells of the heat map along its longer side."""
REACH_M = 5.0
"""The heat map is transparent farther than this from every mote."""
ALPHA = 150


class FloorLayer(Layer):
    """Free, occupied and unknown floor as one picture, sent when it changed and at most once a second."""

    name, label, period_s = "floor", "Floor", 1.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._picture = FloorPicture(scene, self.node("picture"))
        self._seen: FloorVersion | None = None

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        floor = view.floor if view.floor_version != self._seen else None
        if floor is None:
            return
        self._seen = view.floor_version
        geometry = floor.geometry
        times = max(1, min(MAGNIFIED, TEXTURE_PX // max(geometry.shape)))
        picture = floor.picture(UNKNOWN, FREE, OCCUPIED).repeat(times, axis=0).repeat(times, axis=1)
        self._picture.show(picture, bounds_of(geometry), FLOOR_Z_M)


class WallLayer(MeshLayer):
    """Occupied cells as boxes, sent when they changed and at most every two seconds."""

    name, label, period_s = "walls", "Walls", 2.0
    _seen: FloorVersion | None = None

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        if view.floor_version != self._seen:
            self._seen = view.floor_version
            super()._draw(view, now_s)

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        floor = view.floor
        boxes = np.empty((0, 4), np.float32) if floor is None else floor.wall_boxes()
        count = len(boxes)
        positions = np.column_stack([boxes[:, :2], np.zeros(count, np.float32)])
        sizes = np.column_stack([boxes[:, 2:], np.full(count, WALL_HEIGHT_M, np.float32)])
        return {WALL: copies(cube(), positions, sizes)}


class FieldLayer(Layer):
    """The field between the readings of one quantity, by inverse distances; transparent where no mote is near."""

    name, label, period_s, shown_at_first = "field", "Heat map", 2.0, False

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self.range: tuple[str, float, float] | None = None
        """Quantity, lowest and highest value of the drawn field; for a legend."""
        self._picture = FloorPicture(scene, self.node("picture"))

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        bounds = view.map.known_bounds_m()
        quantity = most_read(view)
        if bounds is None or quantity is None:
            self.range = None
            self._picture.hide()
            return
        points, values = readings_of(view, quantity)
        self.range = (quantity, float(values.min()), float(values.max()))
        x_min, y_min, x_max, y_max = bounds
        cell_m = max(x_max - x_min, y_max - y_min) / CELLS
        shape = (max(1, round((y_max - y_min) / cell_m)), max(1, round((x_max - x_min) / cell_m)))
        self._picture.show(heat_picture(points, values, bounds, shape), bounds, FIELD_Z_M)


def most_read(view: ShownTeam) -> str | None:
    """The quantity that most motes with a known place report; None if there is none."""
    counts = Counter(
        quantity for mote in view.motes.values() if mote.place is not None for quantity in sorted(mote.readings)
    )
    return max(counts, key=lambda quantity: (counts[quantity], quantity)) if counts else None


def readings_of(view: ShownTeam, quantity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (N, 2), metres, arena frame, and the last values (N,) of one quantity."""
    readings = [
        (mote.place.x_m, mote.place.y_m, mote.readings[quantity].value)
        for mote in view.motes.values()
        if mote.place is not None and quantity in mote.readings
    ]
    table = np.array(readings, np.float64).reshape(-1, 3)
    return table[:, :2], table[:, 2]


def heat_picture(
    points: NDArray[np.float64],
    values: NDArray[np.float64],
    bounds: Bounds,
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


FRAME_M, FRAME_HEIGHT_M = 0.06, 0.04
REGION_MARK = diamond(0.16, 0.45)
REGION_LABELS = 12
"""The largest regions get a label."""
INACCESSIBLE = frozenset({LeftKind.TOO_NARROW, LeftKind.UNREACHABLE})
"""Robots could not get there by any try."""


class LeftLayer(LabelledLayer):
    """Unexplored regions, once exploration has ended; regions that robots could enter are amber."""

    name, label, period_s = "left", "Left unexplored", 1.0

    def _texts(self, view: ShownTeam) -> dict[str, tuple[str, Point2D]]:
        labels = {}
        for number, region in enumerate(_regions_of(view)[:REGION_LABELS]):
            text = f"{region.kind.value.replace('_', ' ')}, {region.area_m2:.1f} m2"  # the scene's font has no ²
            labels[f"left-{number}"] = text, region.place
        return labels

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        pieces = []
        for region in _regions_of(view):
            color = BAD if region.kind in INACCESSIBLE else WARNING
            pieces.append((color, region_frame(region)))
            pieces.append((color, copies(REGION_MARK, rows([(region.place.x_m, region.place.y_m, 0.0)]))))
        return by_color(pieces)


def _regions_of(view: ShownTeam) -> list[RegionLeft]:
    return [] if view.left is None else view.left.regions


def region_frame(region: RegionLeft) -> Mesh:
    """Four bars on the floor around a region's bounding box."""
    low, high = region.low, region.high
    width_m, depth_m = high.x_m - low.x_m, high.y_m - low.y_m
    x_m, y_m, z_m = (low.x_m + high.x_m) / 2, (low.y_m + high.y_m) / 2, 0.0
    places = [(x_m, low.y_m, z_m), (x_m, high.y_m, z_m), (low.x_m, y_m, z_m), (high.x_m, y_m, z_m)]
    along, across = (width_m + FRAME_M, FRAME_M, FRAME_HEIGHT_M), (FRAME_M, depth_m + FRAME_M, FRAME_HEIGHT_M)
    return copies(cube(), rows(places), rows([along, along, across, across]))
