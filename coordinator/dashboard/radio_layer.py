"""Who hears which mote, how well, and which robots stand as relays."""

import math
from collections.abc import Collection

import viser

from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.merged_meshes import MergedMeshes, by_color, strips, widen_for
from robrain.coordinator.dashboard.meshes import Mesh
from robrain.coordinator.dashboard.palette import BAD, GOOD, RELAY, WARNING, Rgb
from robrain.coordinator.dashboard.robot_view import MoteView
from robrain.coordinator.dashboard.scene_nodes import dashed
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Relay
from robrain.protocol.wire.messages import MoteReading

LINK_Z_M = 0.2
STRONG_DBM, WEAK_DBM = -80.0, -87.0
LINK_M, RELAY_M = 0.035, 0.14
LINKS = 600
DASHES = 30
ALL_DASHES = 1200
DASH_M = {GOOD: 0.0, WARNING: 0.3, BAD: 0.12}
"""Weaker links have shorter dashes, so that they are told apart without their colour."""


class RadioLayer(Layer):
    """Lines from motes to the robots that heard them in the last seconds; thick ones from relays to their motes."""

    name, label, period_s, shown_at_first = "radio", "Radio links", 1.0, True

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._links = MergedMeshes(scene, self.node("links"))
        self._relays = MergedMeshes(scene, self.node("relays"))

    def _draw(self, view: TeamView, now_s: float) -> None:
        lines = [
            (start, end, link_color(link.rssi_dbm))
            for mote in view.motes.values()
            for link in links_shown(mote, view.selected)
            if (start := mote.place) is not None and (end := _where(view, link.via)) is not None
        ]
        widen = widen_for(view.map.size_m)
        self._links.show(_drawn(lines[:LINKS], LINK_M * widen, widen))
        self._relays.show(_drawn([(start, end, RELAY) for start, end in relay_lines(view)], RELAY_M * widen, widen))


def links_shown(mote: MoteView, selected: Collection[str]) -> list[MoteReading]:
    """A mote's best link, and those to robots that are selected: with all of them nothing else would be seen."""
    best = max(mote.links.values(), key=lambda link: (link.stamp_ns, link.rssi_dbm), default=None)
    return [link for link in mote.links.values() if link is best or link.via in selected]


def link_color(rssi_dbm: float) -> Rgb:
    """Colour of a link's strength."""
    return GOOD if rssi_dbm >= STRONG_DBM else WARNING if rssi_dbm >= WEAK_DBM else BAD


def relay_lines(view: TeamView) -> list[tuple[Point2D, Point2D]]:
    """From each robot that is a relay now to its mote, and to the robot that is next in the chain."""
    lines = []
    for event in view.tasks.values():
        task, here = event.task, _where(view, event.robot)
        if not isinstance(task, Relay) or here is None:
            continue
        mote = view.motes.get(task.mote)
        ends = (mote.place if mote is not None else None, _where(view, task.robot))
        lines += [(here, end) for end in ends if end is not None]
    return lines


def _dash_m(start: Point2D, end: Point2D, color: Rgb, widen: float, most: int) -> float:
    """Length of a link's dashes: as its strength has it, or longer if there would be too many of them."""
    dash_m = DASH_M.get(color, 0.0)
    if not dash_m:
        return 0.0
    return max(widen * dash_m, math.hypot(end.x_m - start.x_m, end.y_m - start.y_m) / (2 * most - 1))


def _where(view: TeamView, name: str) -> Point2D | None:
    robot = view.robots.get(name)
    return None if robot is None or robot.pose is None else Point2D(robot.pose.x_m, robot.pose.y_m)


def _drawn(lines: list[tuple[Point2D, Point2D, Rgb]], width_m: float, widen: float) -> dict[Rgb, Mesh]:
    # Of many links each gets fewer and longer dashes: a browser has to draw every one of them in every frame.
    most = max(2, min(DASHES, ALL_DASHES // max(1, len(lines))))
    return by_color(
        (color, strips(dashed([start, end], _dash_m(start, end, color, widen, most), LINK_Z_M, most), width_m))
        for start, end, color in lines
    )
