"""Selecting in the picture: what a click means, the mark on the selected robot, and the camera that follows it."""

import math
from collections.abc import Mapping

import numpy as np
import viser

from robrain.dashboard.layers.robot_layers import radius_m
from robrain.dashboard.scene.meshes import hoop
from robrain.dashboard.state.shown_robot import ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D, Pose2D

MARK_Z_M = 0.06
COLOR = (255, 255, 255)
STEP_M = 0.01
"""The camera moves when the robot has moved this far."""
NEAR_M = 0.5
NEAR_SHARE = 0.02
"""Picking range: this distance, or this share of the camera's distance, from which a robot looks small."""
FAR_M = 1e5


class SelectionMark:
    """A ring around one robot, in one browser's picture."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._ring: viser.MeshHandle | None = None
        self._size_m = 0.0
        self._at: tuple[float, float] | None = None

    def show(self, robot: ShownRobot | None, *, follows: bool) -> None:
        """Put the ring around a robot, or hide it, and move the camera along if it follows."""
        pose = robot.pose if robot is not None else None
        if robot is None or pose is None:
            if self._ring is not None:
                self._ring.visible = False
            self._at = None
            return
        size_m = 1.9 * radius_m(robot)
        if self._ring is None or size_m != self._size_m:
            self._size_m = size_m
            mesh = hoop(0.88)
            self._ring = self._client.scene.add_mesh_simple(
                "/selected/ring", size_m * mesh.vertices, mesh.faces, color=COLOR, side="double", flat_shading=True,
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        self._ring.visible = True
        place = (pose.x_m, pose.y_m, MARK_Z_M)
        if tuple(self._ring.position) != place:
            self._ring.position = place
        self._follow((pose.x_m, pose.y_m), follows)

    def _follow(self, at: tuple[float, float], follows: bool) -> None:
        before, camera = self._at, self._client.camera
        if not follows:
            self._at = None
            return
        if before is None:
            moved = np.array([at[0] - camera.look_at[0], at[1] - camera.look_at[1], 0.0])
        else:
            moved = np.array([at[0] - before[0], at[1] - before[1], 0.0])
            if np.linalg.norm(moved) < STEP_M:
                return
        self._at = at
        with self._client.atomic():
            camera.position = camera.position + moved  # viser moves the point that is looked at by the same


def floor_hit(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> tuple[Point2D, float] | None:
    """Where a ray meets the floor, arena frame, and how far along it, metres; None if it does not."""
    if not all(map(math.isfinite, (*origin, *direction))) or direction[2] >= 0 or origin[2] <= 0:
        return None
    along = -origin[2] / direction[2]
    x_m, y_m = origin[0] + along * direction[0], origin[1] + along * direction[1]
    distance_m = along * math.sqrt(sum(part * part for part in direction))
    return (Point2D(x_m, y_m), distance_m) if abs(x_m) < FAR_M and abs(y_m) < FAR_M else None


def robot_near(view: ShownTeam, place: Point2D, camera_m: float) -> ShownRobot | None:
    """The nearest robot within picking range of a click; the range grows with the camera's distance."""
    return view.robots.get(_nearest({robot.name: robot.pose for robot in view.robots.values()}, place, camera_m))


def mote_near(view: ShownTeam, place: Point2D, camera_m: float) -> ShownMote | None:
    """The nearest mote within picking range of a click; the range grows with the camera's distance."""
    return view.motes.get(_nearest({mote.name: mote.place for mote in view.motes.values()}, place, camera_m))


def _nearest(places: Mapping[str, Point2D | Pose2D | None], clicked: Point2D, camera_m: float) -> str:
    distances_m = [(place.distance_m(clicked), name) for name, place in places.items() if place is not None]
    distance_m, name = min(distances_m, default=(math.inf, ""))
    return name if distance_m <= max(NEAR_M, NEAR_SHARE * camera_m) else ""
