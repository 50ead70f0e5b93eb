"""The mark on the selected robot, and the camera that follows it; each browser has its own."""

import numpy as np
import viser

from robrain.coordinator.dashboard.layers.robot_layers import radius_m
from robrain.coordinator.dashboard.scene.meshes import hoop
from robrain.coordinator.dashboard.state.robot_view import RobotView

MARK_Z_M = 0.06
COLOR = (255, 255, 255)
STEP_M = 0.01
"""The camera moves when the robot has moved so far."""


class SelectionMark:
    """A ring about one robot, in one browser's picture."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._ring: viser.MeshHandle | None = None
        self._size_m = 0.0
        self._at: tuple[float, float] | None = None

    def show(self, robot: RobotView | None, *, follows: bool) -> None:
        """Put the ring about a robot, or nowhere, and move the camera along if it follows."""
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
            camera.position = camera.position + moved  # viser takes the point that is looked at along
