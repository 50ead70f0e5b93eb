"""The parts of the page, in one registry: tabs, floating panels, and layers of the picture.

A part is a class derived from `Tab` or `Panel` (`panels/page.py`), or from `Layer` (`layers/layer.py`). Another
distribution adds a part by an entry point:

    [project.entry-points."robrain.dashboard_parts"]
    gas = "my_team.gas:GasLayer"

Topics that a part reads and the page does not know itself stand in its `topics`; their last messages are in
`ShownTeam.others`.
"""

from typing import Any, TypeVar

from robrain.protocol.registry import Registry
from robrain.protocol.topic import Topic

PartT = TypeVar("PartT")

_LAYERS, _PANELS = "robrain.dashboard.layers", "robrain.dashboard.panels"
STOCK = {
    "floor": f"{_LAYERS}.floor_layers:FloorLayer",
    "walls": f"{_LAYERS}.floor_layers:WallLayer",
    "robots": f"{_LAYERS}.robot_layers:RobotLayer",
    "names": f"{_LAYERS}.robot_layers:NameLayer",
    "trails": f"{_LAYERS}.track_layers:TrailLayer",
    "paths": f"{_LAYERS}.track_layers:PathLayer",
    "traffic": f"{_LAYERS}.track_layers:TrafficLayer",
    "task_marks": f"{_LAYERS}.marker_layers:TaskLayer",
    "chargers": f"{_LAYERS}.marker_layers:ChargerLayer",
    "zones": f"{_LAYERS}.marker_layers:ZoneLayer",
    "frontiers": f"{_LAYERS}.marker_layers:FrontierLayer",
    "left": f"{_LAYERS}.floor_layers:LeftLayer",
    "motes": f"{_LAYERS}.marker_layers:MoteLayer",
    "radio": f"{_LAYERS}.radio_layers:RadioLayer",
    "field": f"{_LAYERS}.floor_layers:FieldLayer",
    "certainty": f"{_LAYERS}.robot_layers:CertaintyLayer",
    "truth": f"{_LAYERS}.robot_layers:TruthLayer",
    "lidar": f"{_LAYERS}.marker_layers:ScanLayer",
    "team": f"{_PANELS}.team_tab:TeamTab",
    "robot": f"{_PANELS}.robot_tab:RobotTab",
    "tasks": f"{_PANELS}.task_tab:TaskTab",
    "view": f"{_PANELS}.picture_tab:PictureTab",
    "halt": f"{_PANELS}.halt_control:HaltControl",
    "replay": f"{_PANELS}.replay_bar:ReplayBar",
}
"""robrain's own parts, in the order in which the page shows them."""
DASHBOARD_PARTS: Registry[type] = Registry("dashboard part", "robrain.dashboard_parts", STOCK)


def parts_of(kind: type[PartT]) -> list[type[PartT]]:
    """The parts derived from a class, robrain's own first; a part that cannot be imported is skipped, and logged."""
    return [part for part in DASHBOARD_PARTS.entries().values() if issubclass(part, kind)]


def topics_of_parts() -> list[Topic[Any]]:
    """The topics that parts read besides those of the page itself."""
    return [topic for part in parts_of(object) for topic in getattr(part, "topics", ())]
