"""What exploration has left: a frame around each region, and a mark where its floor or its edge is."""

import viser

from robrain.dashboard.layers.layer import MeshLayer
from robrain.dashboard.scene.merged_meshes import by_color, copies
from robrain.dashboard.scene.meshes import Mesh, cube, diamond
from robrain.dashboard.scene.scene_nodes import Labels, rows
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.maps.left_messages import LeftKind, RegionLeft
from robrain.recording.drawing import palette

FRAME_M, FRAME_HEIGHT_M = 0.06, 0.04
MARK = diamond(0.16, 0.45)
LABELS = 12
"""The largest regions get a label."""
NO_WAY = frozenset({LeftKind.TOO_NARROW, LeftKind.UNREACHABLE})
"""Robots could not get there by any try."""


class LeftLayer(MeshLayer):
    """Regions that exploration has left, once it has ended; others than those that robots can never enter are amber."""

    name, label, period_s = "left", "Left unexplored", 1.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._labels = Labels(scene, self.node("label"), 0.8, below=True)

    def _draw(self, view: TeamView, now_s: float) -> None:
        super()._draw(view, now_s)
        self._labels.show(
            {
                f"left-{number}": (left_label(region), (region.place.x_m, region.place.y_m, 0.0))
                for number, region in enumerate(_regions(view)[:LABELS])
            }
        )

    def _meshes(self, view: TeamView, now_s: float) -> dict[palette.Rgb, Mesh]:
        pieces = []
        for region in _regions(view):
            color = palette.BAD if region.kind in NO_WAY else palette.WARNING
            pieces.append((color, frame(region)))
            pieces.append((color, copies(MARK, rows([(region.place.x_m, region.place.y_m, 0.0)]))))
        return by_color(pieces)


def _regions(view: TeamView) -> list[RegionLeft]:
    return [] if view.left is None else view.left.regions


def left_label(region: RegionLeft) -> str:
    """A region in a few words; the scene's font has no ²."""
    return f"{region.kind.value.replace('_', ' ')}, {region.area_m2:.1f} m2"


def frame(region: RegionLeft) -> Mesh:
    """Four bars on the floor around a region's bounding box."""
    low, high = region.low, region.high
    width_m, depth_m = high.x_m - low.x_m, high.y_m - low.y_m
    x_m, y_m, z_m = (low.x_m + high.x_m) / 2, (low.y_m + high.y_m) / 2, 0.0
    places = [(x_m, low.y_m, z_m), (x_m, high.y_m, z_m), (low.x_m, y_m, z_m), (high.x_m, y_m, z_m)]
    along, across = (width_m + FRAME_M, FRAME_M, FRAME_HEIGHT_M), (FRAME_M, depth_m + FRAME_M, FRAME_HEIGHT_M)
    return copies(cube(), rows(places), rows([along, along, across, across]))
