"""The picture: all layers, and the camera that frames them."""

import viser

from robrain.coordinator.dashboard.camera import (
    FOV_RAD,
    OVERVIEW_ELEVATION_RAD,
    TOP_ELEVATION_RAD,
    Bounds,
    stand_to_see,
)
from robrain.coordinator.dashboard.floor_layers import FloorLayer, WallLayer
from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.marker_layers import FrontierLayer, MoteLayer, ScanLayer
from robrain.coordinator.dashboard.robot_layers import NameLayer, RobotLayer, TruthLayer
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.coordinator.dashboard.track_layers import PathLayer, TrailLayer

LAYERS: tuple[type[Layer], ...] = (
    FloorLayer,
    WallLayer,
    RobotLayer,
    NameLayer,
    TrailLayer,
    PathLayer,
    FrontierLayer,
    MoteLayer,
    ScanLayer,
    TruthLayer,
)
"""In the order of their checkboxes."""
EMPTY_BOUNDS: Bounds = (-6.0, -5.0, 6.0, 5.0)
"""Looked at until there is a map."""
EXPECTED_ASPECT = 1.1
"""Of the picture beside the panel on a laptop's screen; a browser that is there already tells its own."""


class Scene:
    """Draws a TeamView. The first map that comes in is framed for all who look on; later the camera is theirs."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.layers: tuple[Layer, ...] = tuple(layer(server.scene) for layer in LAYERS)
        self._bounds = EMPTY_BOUNDS
        self._framed_run: int | None = None
        server.initial_camera.fov = FOV_RAD
        self._set_initial_camera()

    def draw(self, view: TeamView, now_s: float) -> None:
        """Bring the picture up to date."""
        for layer in self.layers:
            layer.draw(view, now_s)
        if view.map.grid is not None and self._framed_run != view.runs:
            self._framed_run = view.runs
            geometry = view.map.grid.geometry
            self._bounds = (
                geometry.origin_x_m,
                geometry.origin_y_m,
                geometry.origin_x_m + geometry.width * geometry.resolution_m,
                geometry.origin_y_m + geometry.height * geometry.resolution_m,
            )
            self._set_initial_camera()
            for client in self._server.get_clients().values():
                self.show_overview(client)

    def show_overview(self, client: viser.ClientHandle) -> None:
        """Move one browser's camera to where the whole map is seen from the side and above."""
        self._move(client, OVERVIEW_ELEVATION_RAD)

    def show_top(self, client: viser.ClientHandle) -> None:
        """Move one browser's camera above the map, +y up."""
        self._move(client, TOP_ELEVATION_RAD)

    def _move(self, client: viser.ClientHandle, elevation_rad: float) -> None:
        stand = stand_to_see(self._bounds, elevation_rad, client.camera.aspect)
        with client.atomic():
            client.camera.fov = FOV_RAD
            client.camera.position = stand.position
            client.camera.look_at = stand.look_at
            client.camera.up_direction = (0.0, 0.0, 1.0)

    def _set_initial_camera(self) -> None:
        stand = stand_to_see(self._bounds, OVERVIEW_ELEVATION_RAD, EXPECTED_ASPECT)
        self._server.initial_camera.position = stand.position
        self._server.initial_camera.look_at = stand.look_at
