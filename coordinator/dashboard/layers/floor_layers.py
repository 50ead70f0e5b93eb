"""The map: known floor as a picture that lies on the ground, occupied cells as walls that stand on it."""

import numpy as np
import viser

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.scene.merged_meshes import MergedMeshes, copies
from robrain.coordinator.dashboard.scene.meshes import cube
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing.palette import FREE, OCCUPIED, UNKNOWN, WALL
from robrain.protocol.model.mapping.occupancy_grid import GridGeometry

FLOOR_Z_M = -0.01
WALL_HEIGHT_M = 0.35
"""Lower than a real wall, so that a robot behind one is still seen."""
TEXTURE_PX = 2048
"""Cells are magnified up to this size, because the browser smooths between pixels."""
MAGNIFIED = 6


class FloorLayer(Layer):
    """Free, occupied and unknown floor as one picture, sent when it changed and at most once a second."""

    name, label, period_s = "floor", "Floor", 1.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._handle: viser.ImageHandle | None = None
        self._geometry: GridGeometry | None = None
        self._seen: tuple[int, int] | None = None

    def _draw(self, view: TeamView, now_s: float) -> None:
        seen = (view.runs, view.map.version)
        if view.map.grid is None or seen == self._seen:
            return
        self._seen = seen
        geometry = view.map.grid.geometry
        times = max(1, min(MAGNIFIED, TEXTURE_PX // max(geometry.shape)))
        picture = view.map.picture(UNKNOWN, FREE, OCCUPIED).repeat(times, axis=0).repeat(times, axis=1)
        if self._handle is not None and geometry == self._geometry:
            self._handle.image = picture
            return
        self._geometry = geometry
        width_m, height_m = geometry.width * geometry.resolution_m, geometry.height * geometry.resolution_m
        self._handle = self.scene.add_image(
            self.node("picture"),
            picture,
            width_m,
            height_m,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            position=(geometry.origin_x_m + width_m / 2, geometry.origin_y_m + height_m / 2, FLOOR_Z_M),
        )


class WallLayer(Layer):
    """Occupied cells as boxes, sent when they changed and at most each two seconds."""

    name, label, period_s = "walls", "Walls", 2.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._boxes = MergedMeshes(scene, self.node("boxes"))
        self._seen: tuple[int, int] | None = None

    def _draw(self, view: TeamView, now_s: float) -> None:
        seen = (view.runs, view.map.version)
        if seen == self._seen:
            return
        self._seen = seen
        boxes = view.map.wall_boxes()
        count = len(boxes)
        positions = np.column_stack([boxes[:, :2], np.zeros(count, np.float32)])
        sizes = np.column_stack([boxes[:, 2:], np.full(count, WALL_HEIGHT_M, np.float32)])
        self._boxes.show({WALL: copies(cube(), positions, sizes)})
