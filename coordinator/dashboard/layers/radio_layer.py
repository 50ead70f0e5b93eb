"""Radio links as lines: who hears which mote and which robot, how well, and which robots stand as relays.

A stronger link is wider, and a weaker one has shorter dashes, so that they are told apart without their colour.
"""

import math
from typing import NamedTuple

import viser

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.layers.own_layer import OwnLayer
from robrain.coordinator.dashboard.scene.merged_meshes import MergedMeshes, by_color, strips, widen_for
from robrain.coordinator.dashboard.scene.meshes import Mesh
from robrain.coordinator.dashboard.scene.scene_nodes import dashed
from robrain.coordinator.dashboard.state.radio_links import (
    Link,
    links_in_focus,
    relay_lines,
    team_links,
)
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing.palette import BAD, GOOD, RELAY, WARNING, Rgb

LINK_Z_M = 0.2
TEAM_Z_M = 0.24
STRONG_DBM, WEAK_DBM = -80.0, -87.0
RELAY_M = 0.14
TEAM_WIDER = 1.8
"""Than links of motes: on these the team's own messages can be relayed."""
LINKS = 600
DASHES = 30
ALL_DASHES = 1200
OPACITY = 0.6
"""Links are there all the time: paler than what moves."""


class LinkLook(NamedTuple):
    """How links of a strength are drawn."""

    color: Rgb
    width_m: float
    dash_m: float
    """0 is unbroken."""


LOOKS = (LinkLook(GOOD, 0.05, 0.0), LinkLook(WARNING, 0.035, 0.3), LinkLook(BAD, 0.025, 0.12))
"""Strong, weak, very weak."""


class RadioLayer(Layer):
    """The links that connect the team, and thick lines from relays to the robots they serve."""

    name, label, period_s, shown_at_first = "radio", "Radio links", 1.0, True

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._team = MergedMeshes(scene, self.node("team"), OPACITY)
        self._relays = MergedMeshes(scene, self.node("relays"))

    def _draw(self, view: TeamView, now_s: float) -> None:
        widen = widen_for(view.map.size_m)
        self._team.show(link_meshes(team_links(view, now_s), TEAM_Z_M, widen, TEAM_WIDER))
        lines = [strips(dashed([start, end], 0.0, LINK_Z_M, 1), RELAY_M * widen) for start, end in relay_lines(view)]
        self._relays.show(by_color((RELAY, line) for line in lines))


class FocusRadioLayer(OwnLayer):
    """Links of the selected robot, and the best link of each mote in focus; switched with the team's radio links."""

    name, label, period_s = "focus_radio", "Radio links of motes", 1.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._links = MergedMeshes(scene, self.node("links"), OPACITY)

    def _draw(self, view: TeamView, now_s: float) -> None:
        links = links_in_focus(view, self.focus, now_s)
        self._links.show(link_meshes(links, LINK_Z_M, widen_for(view.map.size_m)))


def link_look(rssi_dbm: float) -> LinkLook:
    """How a link of this strength is drawn."""
    return LOOKS[0] if rssi_dbm >= STRONG_DBM else LOOKS[1] if rssi_dbm >= WEAK_DBM else LOOKS[2]


def link_meshes(links: list[Link], z_m: float, widen: float, wider: float = 1.0) -> dict[Rgb, Mesh]:
    """Links as strips, by colour; of too many the first ones."""
    shown = links[:LINKS]
    # Of many links each gets fewer and longer dashes: a browser has to draw every one of them in every frame.
    most = max(2, min(DASHES, ALL_DASHES // max(1, len(shown))))
    pieces = []
    for link in shown:
        look = link_look(link.rssi_dbm)
        dash_m = _dash_m(link, look.dash_m * widen, most)
        pieces.append(
            (look.color, strips(dashed([link.start, link.end], dash_m, z_m, most), look.width_m * widen * wider))
        )
    return by_color(pieces)


def _dash_m(link: Link, dash_m: float, most: int) -> float:
    """Length of a link's dashes: as its strength has it, or longer if there would be too many of them."""
    if not dash_m:
        return 0.0
    return max(dash_m, math.hypot(link.end.x_m - link.start.x_m, link.end.y_m - link.start.y_m) / (2 * most - 1))
