"""The picture: all layers, and the camera that frames them."""

import math
from typing import NamedTuple

import numpy as np
import viser

from robrain.dashboard.layers.layer import Layer, OwnLayer
from robrain.dashboard.scene import camera
from robrain.dashboard.state.parts import parts_of
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D

EMPTY_BOUNDS: camera.Bounds = (-6.0, -5.0, 6.0, 5.0)
"""Shown until there is a map."""
EXPECTED_ASPECT = 1.1
"""Aspect ratio of the picture beside the panel on a laptop's screen, for browsers that have not reported theirs."""
COVERED = 0.16
"""Share of the picture's height that the halt, or the bar of a replay, covers at the bottom."""
COVERED_UPRIGHT = 0.58
UPRIGHT = 0.75
"""A picture narrower than this by its height is a phone's, on which the panel lies at the bottom."""
SAME_ASPECT = 0.03
ZOOMED = 0.65
"""A camera nearer than this share of the overview's distance counts as zoomed in."""
SAME_PLACE_M = 0.01


class Framed(NamedTuple):
    """Framing of the map for a browser."""

    bounds: camera.Bounds
    aspect: float
    elevation_rad: float
    position: tuple[float, float, float]
    distance_m: float
    """Distance from the camera to its target."""


class Scene:
    """Draws a ShownTeam. The first map is framed in all browsers; later each browser moves its own camera."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.layers: tuple[Layer, ...] = tuple(
            layer(server.scene) for layer in parts_of(Layer) if not issubclass(layer, OwnLayer)
        )
        self._bounds = EMPTY_BOUNDS
        self._view: ShownTeam | None = None
        self._framed: dict[int, Framed] = {}
        server.initial_camera.fov = camera.FOV_RAD
        self._set_initial_camera()

    def draw(self, view: ShownTeam, now_s: float) -> None:
        """Draw the changes."""
        is_another = view is not self._view
        self._view = view
        for layer in self.layers:
            if is_another:
                layer.hurry()
            layer.draw(view, now_s)
        geometry = view.floor_geometry
        if geometry is None:
            return
        bounds = camera.bounds_of(geometry)
        if bounds != self._bounds:
            self._bounds = bounds
            self._set_initial_camera()

    def show_overview(self, client: viser.ClientHandle) -> None:
        """Move one browser's camera to where the whole map is seen from the side and above."""
        self._move(client, camera.OVERVIEW_ELEVATION_RAD)

    def show_top(self, client: viser.ClientHandle) -> None:
        """Move one browser's camera above the map, +y up."""
        self._move(client, camera.TOP_ELEVATION_RAD)

    def keep_framed(self, client: viser.ClientHandle) -> None:
        """Frame a new map, or the same one if the window's aspect ratio changed and no user moved the camera."""
        framed = self._framed.get(client.client_id)
        if framed is None:
            return
        if framed.bounds != self._bounds:
            self.show_overview(client)
        elif (
            abs(aspect_of(client) - framed.aspect) > SAME_ASPECT * framed.aspect
            and np.linalg.norm(client.camera.position - np.array(framed.position)) < SAME_PLACE_M
        ):
            self._move(client, framed.elevation_rad)

    def camera_target(self, client: viser.ClientHandle) -> tuple[Point2D | None, float]:
        """Target of a zoomed-in browser's camera, and the visible radius, metres; None if not zoomed in."""
        framed = self._framed.get(client.client_id)
        position, target = client.camera.position, client.camera.look_at
        distance_m = float(np.linalg.norm(position - target))
        if framed is None or not distance_m < ZOOMED * framed.distance_m or not np.isfinite(target).all():
            return None, 0.0
        return Point2D(float(target[0]), float(target[1])), distance_m

    def forget(self, client_id: int) -> None:
        """Drop the data of a browser that has disconnected."""
        self._framed.pop(client_id, None)

    def _move(self, client: viser.ClientHandle, elevation_rad: float) -> None:
        aspect = aspect_of(client)
        covered = COVERED_UPRIGHT if aspect < UPRIGHT else COVERED
        viewpoint = camera.viewpoint_of(self._bounds, elevation_rad, aspect, covered=covered)
        self._framed[client.client_id] = Framed(
            self._bounds, aspect, elevation_rad, viewpoint.position, math.dist(viewpoint.position, viewpoint.target)
        )
        with client.atomic():
            client.camera.fov = camera.FOV_RAD
            client.camera.position = viewpoint.position
            client.camera.look_at = viewpoint.target
            client.camera.up_direction = (0.0, 0.0, 1.0)

    def _set_initial_camera(self) -> None:
        viewpoint = camera.viewpoint_of(self._bounds, camera.OVERVIEW_ELEVATION_RAD, EXPECTED_ASPECT, covered=COVERED)
        self._server.initial_camera.position = viewpoint.position
        self._server.initial_camera.look_at = viewpoint.target


def aspect_of(client: viser.ClientHandle) -> float:
    """Aspect ratio of a browser's window; a default if the browser reports none, as when minimised."""
    width, height = client.camera.image_width, client.camera.image_height
    return width / height if width > 0 and height > 0 else EXPECTED_ASPECT
