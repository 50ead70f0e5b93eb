"""Moving objects: trails, planned paths and goals of the robots; doors, obstacles and people of a simulated floor."""

import math

import numpy as np
import viser

from robrain.dashboard.layers.layer import Layer, MeshLayer
from robrain.dashboard.scene.merged_meshes import by_color, copies, strips, widen_for
from robrain.dashboard.scene.meshes import Mesh, circle, cube, join, pin, prism
from robrain.dashboard.scene.scene_nodes import Instances, Rows, colors, dashed, rows
from robrain.dashboard.state.shown_robot import RobotContact
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.team.arena_messages import BodyKind, BodyTruth
from robrain.protocol.model.geometry import Point2D
from robrain.recording.drawing.palette import DOOR, MOVER, PERSON, Rgb, style_of

TRAIL_Z_M = 0.015
PATH_Z_M = 0.03
ALL_TRAILS_SEGMENTS = 2000
"""Shared by the team, so that trails of a hundred robots stay a message of 50 kB a second."""
TRAIL_M = 0.1
OLDEST_SHARE = 0.3
"""Share of a trail's width at its oldest point."""
PATH_M = 0.1
DASH_M = 0.18
DASHES = 400
PIN = pin(0.13, 0.55)


class TrailLayer(MeshLayer):
    """The track of each robot, the thinner the older."""

    name, label, period_s = "trails", "Trails", 1.0

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        each = ALL_TRAILS_SEGMENTS // max(1, len(view.robots))
        width_m = TRAIL_M * widen_for(view.map.size_m)
        return by_color(
            (style_of(robot.index).color, tapering_line(list(robot.trail), each, width_m))
            for robot in view.robots_in_order()
            if len(robot.trail) > 1
        )


class PathLayer(MeshLayer):
    """The planned path of each robot, dashed, and a pin at its goal."""

    name, label, period_s = "paths", "Paths, goals", 0.3

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        width_m = PATH_M * widen_for(view.map.size_m)
        pieces = []
        for robot in view.robots_in_order():
            if robot.contact(now_s) is RobotContact.LOST:
                continue
            color = style_of(robot.index).color
            pieces.append((color, strips(dashes(robot.path), width_m)))
            goal = view.goal_of(robot)
            if goal is not None:
                pieces.append((color, copies(PIN, rows([(goal.x_m, goal.y_m, 0.0)]))))
        return by_color(pieces)


def tapering_line(trail: list[Point2D], segments: int, width_m: float) -> Mesh:
    """A trail as at most `segments` strips, narrow where it is old and `width_m` wide at its end."""
    stride = max(1, math.ceil((len(trail) - 1) / max(1, segments)))
    # Kept from the end, so that the line always reaches the robot.
    kept = trail[::-1][::stride][::-1]
    corners = np.array([(point.x_m, point.y_m, TRAIL_Z_M) for point in kept], np.float32)
    widths_m = np.linspace(OLDEST_SHARE, 1.0, max(1, len(kept) - 1), dtype=np.float32) * np.float32(width_m)
    return strips(np.stack([corners[:-1], corners[1:]], axis=1), widths_m[: len(kept) - 1])


def dashes(path: list[Point2D]) -> Rows:
    """A path as dashes of equal length, float32 (N, 2, 3), metres; the longest paths are cut off."""
    return dashed(path, DASH_M, PATH_Z_M, DASHES)


HEIGHTS_M = {BodyKind.DOOR: 0.45, BodyKind.MOVER: 0.4, BodyKind.PERSON: 0.8}
"""A door stands a little above walls, which are drawn 0.35 m high."""
COLORS = {BodyKind.DOOR: DOOR, BodyKind.MOVER: MOVER, BodyKind.PERSON: PERSON}
THINNEST_M = 0.2
"""A door is drawn at least so thick."""
BODIES = 500


def person() -> Mesh:
    """A body of diameter 1 and height 1, with shoulders and a head."""
    return join(
        prism(circle(0.36, 16), 0.0, 0.45),
        prism(circle(0.5, 16), 0.45, 0.76),
        prism(circle(0.27, 12), 0.76, 1.0),
    )


def column() -> Mesh:
    """A disc of diameter 1 and height 1."""
    return prism(circle(0.5, 20), 0.0, 1.0)


class TrafficLayer(Layer):
    """Doors and boxes as blocks, round obstacles as columns, people with a head. An open door is not drawn."""

    name, label, period_s = "traffic", "Doors and people", 0.2

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._blocks = Instances(scene, self.node("blocks"), cube())
        self._columns = Instances(scene, self.node("columns"), column())
        self._people = Instances(scene, self.node("people"), person())

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        bodies = bodies_of(view)
        people = [body for body in bodies if body.kind is BodyKind.PERSON]
        others = [body for body in bodies if body.kind is not BodyKind.PERSON]
        _show(self._people, people)
        _show(self._columns, [body for body in others if body.is_round])
        _show(self._blocks, [body for body in others if not body.is_round])


def bodies_of(view: ShownTeam) -> list[BodyTruth]:
    """The bodies to draw; none without an arena."""
    bodies = view.truth.bodies if view.truth is not None else None
    return bodies[:BODIES] if isinstance(bodies, list) else []


def _show(instances: Instances, bodies: list[BodyTruth]) -> None:
    instances.show(
        rows([(body.pose.x_m, body.pose.y_m, 0.0) for body in bodies]),
        rows([(body.length_m, max(body.width_m, THINNEST_M), HEIGHTS_M[body.kind]) for body in bodies]),
        colors([COLORS[body.kind] for body in bodies]),
        np.array([body.pose.yaw_rad for body in bodies], np.float32),
    )
