"""The robots: bodies that show where they face, names above them, and where they truly are."""

import numpy as np
import viser

from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.meshes import robot_base, robot_body, robot_nose
from robrain.coordinator.dashboard.palette import HALTED, LOST, NOSE, TRUTH, Rgb, look_of
from robrain.coordinator.dashboard.scene_nodes import Instances, Labels, Segments, colors, ring, rows
from robrain.coordinator.dashboard.team_view import Contact, RobotView, TeamView

DEFAULT_RADIUS_M = 0.2
"""Of a Robertino, where a robot does not tell."""
LABEL_Z_M = 0.45
FEW_ROBOTS = 20
MANY_LABELS_PERIOD_S = 0.5
RING_Z_M = 0.02


class RobotLayer(Layer):
    """All bodies as one batched mesh, rims and noses as two more; those lost are grey, those halted rimmed in red."""

    name, label, period_s = "robots", "Robots", 0.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._bases = Instances(scene, self.node("bases"), robot_base())
        self._bodies = Instances(scene, self.node("bodies"), robot_body())
        self._noses = Instances(scene, self.node("noses"), robot_nose())

    def _draw(self, view: TeamView, now_s: float) -> None:
        robots = [robot for robot in view.robots_in_order() if robot.pose is not None]
        poses = [robot.pose for robot in robots if robot.pose is not None]
        positions = rows([(pose.x_m, pose.y_m, 0.0) for pose in poses])
        yaw_rad = np.array([pose.yaw_rad for pose in poses], np.float32)
        scales = rows([(radius_m(robot),) * 3 for robot in robots])
        self._bodies.show(positions, scales, colors([body_color(robot, now_s) for robot in robots]), yaw_rad)
        self._bases.show(positions, scales, colors([HALTED if robot.halted else NOSE for robot in robots]))
        self._noses.show(positions, scales, colors([NOSE] * len(robots)), yaw_rad)


class NameLayer(Layer):
    """Robots' names; of large teams they follow more slowly, as each label is a message of its own."""

    name, label, period_s = "names", "Names", 0.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._labels = Labels(scene, self.node("robot"))
        self._moved_s = 0.0

    def _draw(self, view: TeamView, now_s: float) -> None:
        if len(view.robots) > FEW_ROBOTS and now_s - self._moved_s < MANY_LABELS_PERIOD_S:
            return
        self._moved_s = now_s
        self._labels.show(
            {
                robot.name: (_text(robot, now_s), (robot.pose.x_m, robot.pose.y_m, LABEL_Z_M))
                for robot in view.robots_in_order()
                if robot.pose is not None
            }
        )


class TruthLayer(Layer):
    """White rings where an arena says that the robots are; how far off a robot's belief is can be seen by them."""

    name, label, period_s, shown_at_first = "truth", "True places (arena)", 0.2, False

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._rings = Segments(scene, self.node("rings"), 1.5)

    def _draw(self, view: TeamView, now_s: float) -> None:
        rings = [
            ring(1.2 * radius_m(robot)) + np.array([robot.truth.pose.x_m, robot.truth.pose.y_m, RING_Z_M], np.float32)
            for robot in view.robots_in_order()
            if robot.truth is not None
        ]
        points = np.concatenate(rings) if rings else np.empty((0, 2, 3), np.float32)
        self._rings.show(points, np.full(points.shape, TRUTH, np.uint8))


def radius_m(robot: RobotView) -> float:
    """Radius of the robot's footprint."""
    told_m = robot.state.radius_m if robot.state is not None else 0.0
    return told_m if 0.0 < told_m <= 10.0 else DEFAULT_RADIUS_M


def body_color(robot: RobotView, now_s: float) -> Rgb:
    """The robot's own colour, or grey when it is lost."""
    return LOST if robot.contact(now_s) is Contact.LOST else look_of(robot.index).color


def _text(robot: RobotView, now_s: float) -> str:
    contact = robot.contact(now_s)
    if contact is not Contact.UP:
        return f"{robot.name} {contact}"
    return f"{robot.name} halted" if robot.halted else robot.name
