"""Radio links as lines: connected robots and motes, the quality of each link, and the relays.

A stronger link is wider, and a weaker one has shorter dashes, so that they are distinguishable without colours.
"""

from typing import NamedTuple

import numpy as np
import viser

from robrain.dashboard.layers.layer import MeshLayer, OwnLayer
from robrain.dashboard.scene.merged_meshes import MergedMeshes, by_color, strips, widen_for
from robrain.dashboard.scene.meshes import Mesh
from robrain.dashboard.scene.scene_nodes import dashed
from robrain.dashboard.state.radio_links import DrawnLink, links_in_focus, mote_routes, relay_lines, team_links
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D
from robrain.recording.drawing.palette import BAD, GOOD, RELAY, ROUTE, WARNING, Rgb

LINK_Z_M = 0.2
TEAM_Z_M = 0.24
STRONG_DBM, WEAK_DBM = -80.0, -87.0
RELAY_M = 0.14
ROUTE_M = 0.09
ROUTE_TIP_M = 0.02
"""A route is wide at the mote that sends and narrow at the receiver."""
ROUTES = 600
TEAM_WIDER = 1.8
"""Factor of the width of motes' links: over the team's links its own messages can be relayed."""
LINKS = 600
DASHES = 30
ALL_DASHES = 1200
OPACITY = 0.6
"""Links are always shown, so they are paler than moving objects."""


class LinkStyle(NamedTuple):
    """Style of links of a strength."""

    color: Rgb
    width_m: float
    dash_m: float
    """0 is unbroken."""


LINK_STYLES = (LinkStyle(GOOD, 0.05, 0.0), LinkStyle(WARNING, 0.035, 0.3), LinkStyle(BAD, 0.025, 0.12))
"""Strong, weak, very weak."""


class FocusRadioLayer(OwnLayer, MeshLayer):
    """Links of the selected robot, and the best link of each mote in focus; switched with the team's radio links."""

    name, label, period_s = "focus_radio", "Radio links of motes", 1.0

    opacity = OPACITY

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        links = links_in_focus(view, self.focus, now_s)
        return link_meshes(links, LINK_Z_M, widen_for(view.map.size_m))


class RadioLayer(MeshLayer):
    """The links that connect the team, lines from relays to the robots they serve, and routes between motes."""

    name, label, period_s, shown_at_first = "radio", "Radio links", 1.0, True
    detail = FocusRadioLayer

    opacity = OPACITY

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._relays = MergedMeshes(scene, self.node("relays"))

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[Rgb, Mesh]:
        return link_meshes(team_links(view, now_s), TEAM_Z_M, widen_for(view.map.size_m), TEAM_WIDER)

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        super()._draw(view, now_s)
        widen = widen_for(view.map.size_m)
        lines = [strips(dashed([start, end], 0.0, LINK_Z_M, 1), RELAY_M * widen) for start, end in relay_lines(view)]
        routes = [taper(start, end, LINK_Z_M, widen) for start, end in mote_routes(view)[:ROUTES]]
        self._relays.show(by_color([*((RELAY, line) for line in lines), *((ROUTE, route) for route in routes)]))


def link_style(rssi_dbm: float) -> LinkStyle:
    """Style of a link of this strength."""
    return LINK_STYLES[0] if rssi_dbm >= STRONG_DBM else LINK_STYLES[1] if rssi_dbm >= WEAK_DBM else LINK_STYLES[2]


def link_meshes(links: list[DrawnLink], z_m: float, widen: float, wider: float = 1.0) -> dict[Rgb, Mesh]:
    """Links as strips, by colour; of too many the first ones."""
    shown = links[:LINKS]
    # Of many links each gets fewer and longer dashes: a browser has to draw every one of them in every frame.
    most = max(2, min(DASHES, ALL_DASHES // max(1, len(shown))))
    pieces = []
    for link in shown:
        style = link_style(link.rssi_dbm)
        dash_m = style.dash_m * widen
        if dash_m:  # longer if there would be too many
            dash_m = max(dash_m, link.start.distance_m(link.end) / (2 * most - 1))
        lines = dashed([link.start, link.end], dash_m, z_m, most)
        pieces.append((style.color, strips(lines, style.width_m * widen * wider)))
    return by_color(pieces)


def taper(start: Point2D, end: Point2D, z_m: float, widen: float) -> Mesh:
    """A flat strip that narrows towards its end: the direction of a flow."""
    length_m = max(start.distance_m(end), 1e-9)
    across_x, across_y = (start.y_m - end.y_m) / length_m, (end.x_m - start.x_m) / length_m
    corners = []
    for place, width_m in ((start, ROUTE_M), (end, ROUTE_TIP_M)):
        half_m = 0.5 * width_m * widen
        for side in (-half_m, half_m):
            corners.append((place.x_m + side * across_x, place.y_m + side * across_y, z_m))
    return Mesh(np.array(corners, np.float32), np.array([[0, 2, 3], [0, 3, 1]], np.uint32))
