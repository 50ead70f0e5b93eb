"""The robots: bodies, names above them, uncertainty and true places; and selecting robots and motes in the picture."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import viser

from robrain.dashboard.layers.layer import Layer, MeshLayer
from robrain.dashboard.scene.merged_meshes import by_color, copies
from robrain.dashboard.scene.meshes import Mesh, hoop, robot_base, robot_body, robot_dart, robot_nose
from robrain.dashboard.scene.scene_nodes import Instances, Labels, colors, rows
from robrain.dashboard.state.shown_robot import RobotContact, RobotHealth, ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.recording.drawing.palette import HALTED, LOST, NOSE, TRUTH, Rgb, style_of

DEFAULT_RADIUS_M = 0.2
"""That of a Robertino, for robots that report none."""
LABEL_Z_M = 0.45
FEW_ROBOTS = 20
LABELS_MAX = 40
"""In a larger team only robots that are selected or not up have labels."""
MANY_LABELS_PERIOD_S = 0.5
RING_Z_M = 0.02
SIGMAS = 2.4477
"""The ellipse holds the robot with 95 %: √5.991, the chi-square quantile of two degrees of freedom."""
HOOP = hoop(0.94)
LARGEST_M = 50.0


class RobotLayer(Layer):
    """All bodies as one batched mesh, rims and noses as two more; lost robots are grey, halted ones rimmed in red.

    Robots of a large team are darts instead: each batched mesh costs its share of the browser's frames.
    """

    name, label, period_s = "robots", "Robots", 0.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._bases = Instances(scene, self.node("bases"), robot_base())
        self._bodies = Instances(scene, self.node("bodies"), robot_body())
        self._noses = Instances(scene, self.node("noses"), robot_nose())
        self._darts = Instances(scene, self.node("darts"), robot_dart())

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        robots = [robot for robot in view.robots_in_order() if robot.pose is not None]
        poses = [robot.pose for robot in robots if robot.pose is not None]
        positions = rows([(pose.x_m, pose.y_m, 0.0) for pose in poses])
        yaw_rad = np.array([pose.yaw_rad for pose in poses], np.float32)
        scales = rows([(radius_m(robot),) * 3 for robot in robots])
        shades = colors([body_color(robot, now_s) for robot in robots])
        few = len(robots) <= FEW_ROBOTS
        none = np.zeros(0, np.int64)
        rimmed = np.array([i for i, robot in enumerate(robots) if few or robot.halted], np.int64)
        rims = colors([HALTED if robot.halted else NOSE for robot in robots])
        self._bases.show(positions[rimmed], scales[rimmed], rims[rimmed])
        fine = np.arange(len(robots)) if few else none
        coarse = none if few else np.arange(len(robots))
        self._bodies.show(positions[fine], scales[fine], shades[fine], yaw_rad[fine])
        self._noses.show(positions[fine], scales[fine], colors([NOSE] * len(fine)), yaw_rad[fine])
        self._darts.show(positions[coarse], scales[coarse], shades[coarse], yaw_rad[coarse])


class NameLayer(Layer):
    """Robots' names; in large teams they are updated less often, as each label is a separate message."""

    name, label, period_s = "names", "Names", 0.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._labels = Labels(scene, self.node("robot"))
        self._moved_s = 0.0

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        if len(view.robots) > FEW_ROBOTS and now_s - self._moved_s < MANY_LABELS_PERIOD_S:
            return
        self._moved_s = now_s
        all_of_them = len(view.robots) <= LABELS_MAX
        self._labels.show(
            {
                robot.name: (_text(robot, now_s), (robot.pose.x_m, robot.pose.y_m, LABEL_Z_M))
                for robot in view.robots_in_order()
                if robot.pose is not None and (all_of_them or is_special(view, robot, now_s))
            }
        )


class TruthLayer(Layer):
    """White rings at the true places that an arena publishes: they show the errors of the robots' poses."""

    name, label, period_s, shown_at_first = "truth", "True places", 0.2, False

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._rings = Instances(scene, self.node("rings"), hoop(0.85))

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        known = [(robot, robot.truth.pose) for robot in view.robots_in_order() if robot.truth is not None]
        self._rings.show(
            rows([(pose.x_m, pose.y_m, RING_Z_M) for _, pose in known]),
            rows([(1.3 * radius_m(robot), 1.3 * radius_m(robot), 1.0) for robot, _ in known]),
            colors([TRUTH] * len(known)),
        )


class CertaintyLayer(MeshLayer):
    """95 % ellipses of the robots' places, by their own covariances."""

    name, label, period_s, shown_at_first = "certainty", "Uncertainty", 0.5, True

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        pieces = []
        for robot in view.robots_in_order():
            found = ellipse(robot.state.pose_covariance) if robot.state is not None else None
            if robot.pose is None or found is None:
                continue
            place = rows([(robot.pose.x_m, robot.pose.y_m, RING_Z_M)])
            size, turn_rad = rows([(found.long_m, found.short_m, 1.0)]), np.array([found.turn_rad], np.float32)
            pieces.append((style_of(robot.index).color, copies(HOOP, place, size, turn_rad)))
        return by_color(pieces)


class Ellipse(NamedTuple):
    """Half-axes, metres, and the angle of the long one from x, radians."""

    long_m: float
    short_m: float
    turn_rad: float


def ellipse(covariance: tuple[float, ...]) -> Ellipse | None:
    """The 95 % ellipse of a row-major 3 × 3 covariance of x, y, yaw.

    None if there is no covariance, if it is not positive semi-definite, or if the ellipse is too large to be drawn.
    """
    if len(covariance) != 9 or not all(map(math.isfinite, covariance)):
        return None
    values, vectors = np.linalg.eigh(np.array([[covariance[0], covariance[1]], [covariance[1], covariance[4]]]))
    if values[0] < 0 or SIGMAS * math.sqrt(values[1]) > LARGEST_M:
        return None
    long_m, short_m = SIGMAS * math.sqrt(values[1]), SIGMAS * math.sqrt(values[0])
    return Ellipse(long_m, short_m, math.atan2(vectors[1, 1], vectors[0, 1]))


def is_special(view: ShownTeam, robot: ShownRobot, now_s: float) -> bool:
    """Whether a robot is selected or not up."""
    return robot.name in view.selected or robot.condition(now_s) not in (RobotHealth.UP, RobotHealth.READY)


def radius_m(robot: ShownRobot) -> float:
    """Radius of the robot's footprint."""
    reported_m = robot.state.radius_m if robot.state is not None else 0.0
    return reported_m if 0.0 < reported_m <= 10.0 else DEFAULT_RADIUS_M


def body_color(robot: ShownRobot, now_s: float) -> Rgb:
    """The robot's own colour, or grey when it is lost."""
    return LOST if robot.contact(now_s) is RobotContact.LOST else style_of(robot.index).color


def _text(robot: ShownRobot, now_s: float) -> str:
    contact = robot.contact(now_s)
    if contact is not RobotContact.UP:
        return f"{robot.title} {contact}"
    return f"{robot.title} halted" if robot.halted else robot.title


MARK_Z_M = 0.06
COLOR = (255, 255, 255)
STEP_M = 0.01
"""The camera moves when the robot has moved this far."""
NEAR_M = 0.5
NEAR_SHARE = 0.02
"""Picking range: this distance, or this share of the camera's distance, from which a robot appears small."""
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
            camera.position = camera.position + moved  # viser moves the camera's target by the same


def floor_hit(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> tuple[Point2D, float] | None:
    """Point where a ray meets the floor, arena frame, and the distance along it, metres; None if it does not."""
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
