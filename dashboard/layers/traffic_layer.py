"""What moves on a simulated floor besides robots: closed doors, moving obstacles and people."""

import numpy as np
import viser

from robrain.dashboard.layers.layer import Layer
from robrain.dashboard.scene.meshes import Mesh, circle, cube, join, prism
from robrain.dashboard.scene.scene_nodes import Instances, colors, rows
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.team.arena_messages import BodyKind, BodyTruth
from robrain.recording.drawing import palette

HEIGHTS_M = {BodyKind.DOOR: 0.45, BodyKind.MOVER: 0.4, BodyKind.PERSON: 0.8}
"""A door stands a little above walls, which are drawn 0.35 m high."""
COLORS = {BodyKind.DOOR: palette.DOOR, BodyKind.MOVER: palette.MOVER, BodyKind.PERSON: palette.PERSON}
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

    def _draw(self, view: TeamView, now_s: float) -> None:
        bodies = bodies_of(view)
        people = [body for body in bodies if body.kind is BodyKind.PERSON]
        others = [body for body in bodies if body.kind is not BodyKind.PERSON]
        _show(self._people, people)
        _show(self._columns, [body for body in others if body.is_round])
        _show(self._blocks, [body for body in others if not body.is_round])


def bodies_of(view: TeamView) -> list[BodyTruth]:
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
