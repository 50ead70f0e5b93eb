"""How well robots know where they are: an ellipse about each."""

import math
from typing import NamedTuple

import numpy as np
import viser

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.scene.merged_meshes import MergedMeshes, by_color, copies
from robrain.coordinator.dashboard.scene.meshes import hoop
from robrain.coordinator.dashboard.scene.scene_nodes import rows
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing.palette import look_of

SIGMAS = 2.4477
"""The ellipse holds the robot with 95 %: √5.991, the chi-square quantile of two degrees of freedom."""
ELLIPSE_Z_M = 0.02
HOOP = hoop(0.94)
LARGEST_M = 50.0


class CertaintyLayer(Layer):
    """95 % ellipses of the robots' places, by their own covariances."""

    name, label, period_s, shown_at_first = "certainty", "Uncertainty", 0.5, True

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._hoops = MergedMeshes(scene, self.node("ellipses"))

    def _draw(self, view: TeamView, now_s: float) -> None:
        pieces = []
        for robot in view.robots_in_order():
            found = ellipse(robot.state.pose_covariance) if robot.state is not None else None
            if robot.pose is None or found is None:
                continue
            place = rows([(robot.pose.x_m, robot.pose.y_m, ELLIPSE_Z_M)])
            size, turn_rad = rows([(found.long_m, found.short_m, 1.0)]), np.array([found.turn_rad], np.float32)
            pieces.append((look_of(robot.index).color, copies(HOOP, place, size, turn_rad)))
        self._hoops.show(by_color(pieces))


class Ellipse(NamedTuple):
    """Half-axes, metres, and how far the long one is turned from x."""

    long_m: float
    short_m: float
    turn_rad: float


def ellipse(covariance: tuple[float, ...]) -> Ellipse | None:
    """The 95 % ellipse of a row-major 3 × 3 covariance of x, y, yaw.

    None if there is no covariance, if it is none, or if the ellipse is too large to be drawn.
    """
    if len(covariance) != 9 or not all(map(math.isfinite, covariance)):
        return None
    values, vectors = np.linalg.eigh(np.array([[covariance[0], covariance[1]], [covariance[1], covariance[4]]]))
    if values[0] < 0 or SIGMAS * math.sqrt(values[1]) > LARGEST_M:
        return None
    long_m, short_m = SIGMAS * math.sqrt(values[1]), SIGMAS * math.sqrt(values[0])
    return Ellipse(long_m, short_m, math.atan2(vectors[1, 1], vectors[0, 1]))
