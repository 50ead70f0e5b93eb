"""Marks on the map: chargers, zones, tasks, frontiers, motes with their readings, and lidar scans."""

import numpy as np
import viser

from robrain.dashboard.layers.layer import LabelledLayer, MeshLayer, OwnLayer
from robrain.dashboard.scene.merged_meshes import by_color, copies, strips
from robrain.dashboard.scene.meshes import Mesh, bolt, cube, diamond, flag, pin, tent
from robrain.dashboard.scene.scene_nodes import Labels, Rows, colors, rows, to_linear
from robrain.dashboard.state.focus import motes_in_focus
from robrain.dashboard.state.shown_robot import ShownMote, ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.zone_messages import COORDINATOR_ZONES, Zones
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.recording.drawing import palette

FRONTIER_SIZE_M = 0.1
MOTE_LABEL_Z_M = 0.35
SCAN_Z_M = 0.15
PLATE_M = (0.55, 0.55, 0.03)
FLAG, PIN = flag(), pin(0.16, 0.65)
TASKS = 400
TASK_LABELS = 25


class ChargerLayer(MeshLayer):
    """Chargers: plates on the floor with a bolt above."""

    name, label, period_s = "chargers", "Chargers", 2.0

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[palette.Rgb, Mesh]:
        places = rows([(place.x_m, place.y_m, 0.0) for place in view.chargers])
        return {
            palette.CHARGER_PLATE: copies(cube(), places, rows([PLATE_M] * len(places))),
            palette.CHARGER: copies(bolt(), places),
        }


class TaskLayer(LabelledLayer):
    """Open tasks requested by a client: a flag waits for a robot, a pin in a robot's colour has one."""

    name, label, period_s = "tasks", "Tasks", 0.5

    def _texts(self, view: ShownTeam) -> dict[str, tuple[str, Point2D]]:
        events = _marked_tasks(view)
        labelled = events if len(events) <= TASK_LABELS else []
        return {event.task.id: (task_label(event), event.task.place) for event in labelled}

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[palette.Rgb, Mesh]:
        pieces = []
        for event in _marked_tasks(view):
            place = rows([(event.task.place.x_m, event.task.place.y_m, 0.0)])
            robot = view.robots.get(event.robot)
            color = (
                palette.style_of(robot.index).color if robot is not None and has_robot(event) else palette.TASK_WAITING
            )
            pieces.append((color, copies(PIN if has_robot(event) else FLAG, place)))
        return by_color(pieces)


def _marked_tasks(view: ShownTeam) -> list[TaskEvent]:
    return [event for event in view.tasks.values() if event.task.kind != "explore"][-TASKS:]


def has_robot(event: TaskEvent) -> bool:
    """Whether a robot works on it."""
    return event.state in (TaskState.RUNNING, TaskState.LOST_CONTACT)


def task_label(event: TaskEvent) -> str:
    """A task in a few words."""
    who = f" {event.robot}" if event.robot and has_robot(event) else ""
    state = "lost contact" if event.state is TaskState.LOST_CONTACT else event.state.value
    return f"{event.task.kind} {state}{who}"


class ZoneLayer(LabelledLayer):
    """Zones: their borders on the floor, with names and rules."""

    name, label, period_s = "zones", "Zones", 1.0
    topics = (COORDINATOR_ZONES,)

    def _texts(self, view: ShownTeam) -> dict[str, tuple[str, Point2D]]:
        zones = view.zones
        return {zone.name: (_zone_label(zone, zones), zone.centre) for zone in zones.all[:ZONE_LABELS]}

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[palette.Rgb, Mesh]:
        zones = view.zones
        borders = [(color_of(zone), zone) for zone in zones.zones]
        borders += [(palette.TASK_WAITING, zone) for zone in zones.off]
        return by_color((color, strips(border(zone), ZONE_BORDER_M)) for color, zone in borders)


def _zone_label(zone: Zone, zones: Zones) -> str:
    rule = "" if zone.kind is ZoneKind.PLACE else zone.rule
    words = ", ".join(filter(None, (rule, zones.turn_text(zone))))
    return f"{zone.name}: {words}" if words else zone.name


ZONE_COLORS = {
    ZoneKind.KEEP_OUT: palette.BAD,
    ZoneKind.SPEED_LIMIT: palette.WARNING,
    ZoneKind.PENALTY: palette.CHARGER,
    ZoneKind.RESERVED: palette.WARNING,
    ZoneKind.DOOR: palette.CHARGER,
    ZoneKind.DIRECTED: palette.CHARGER,
    ZoneKind.NO_STOPPING: palette.WARNING,
    ZoneKind.PLACE: palette.ROUTE,
}


def color_of(zone: Zone) -> palette.Rgb:
    """Colour of a zone's border."""
    return palette.BAD if zone.is_shut else ZONE_COLORS[zone.kind]


ZONE_BORDER_M, ZONE_Z_M = 0.1, 0.02
ZONE_LABELS = 50


def border(zone: Zone) -> Rows:
    """The sides of a zone, float32 (N, 2, 3), metres."""
    sides = zone.sides or ((zone.corners_m[0], zone.corners_m[-1]),)
    return rows([(x_m, y_m, ZONE_Z_M) for side in sides for x_m, y_m in side]).reshape(-1, 2, 3)


class FrontierLayer(MeshLayer):
    """Frontiers that the coordinator sees, the longer the larger."""

    name, label, period_s = "frontiers", "Frontiers", 1.0

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[palette.Rgb, Mesh]:
        frontiers = view.team.frontiers if view.team is not None else []
        sizes_m = [FRONTIER_SIZE_M * min(2.0, max(0.8, frontier.length_m**0.5)) for frontier in frontiers]
        places = rows([(frontier.place.x_m, frontier.place.y_m, 0.0) for frontier in frontiers])
        return {palette.FRONTIER: copies(diamond(1.0, 1.6), places, rows([(size_m,) * 3 for size_m in sizes_m]))}


MOTE_MESHES: tuple[tuple[Mesh, float], ...] = (
    (diamond(0.14, 0.3), 1.0),
    (tent(0.18, 0.26), 1.0),
    (cube(), 0.2),
    (diamond(0.09, 0.2), 1.0),
)
"""Shape and scale by `palette.mote_class`: a diamond is well, a pyramid is low, a cube is nearly empty."""


class MoteLabelLayer(OwnLayer):
    """Latest readings of the motes in focus."""

    name, label, period_s = "mote_labels", "Readings of motes", 1.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._labels = Labels(scene, self.node("reading"), 0.8)

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        self._labels.show(
            {
                mote.name: (reading_text(mote), (mote.place.x_m, mote.place.y_m, MOTE_LABEL_Z_M))
                for mote in motes_in_focus(view, self.focus)
                if mote.place is not None
            }
        )


class MoteLayer(MeshLayer):
    """Motes; colour and shape show the state of their supply."""

    name, label, period_s = "motes", "Motes", 1.0
    detail = MoteLabelLayer

    def _meshes(self, view: ShownTeam, now_s: float) -> dict[palette.Rgb, Mesh]:
        places: dict[int, list[tuple[float, float, float]]] = {}
        for mote in view.motes.values():
            if mote.place is not None:
                kind = palette.mote_class(mote.latest.voltage_v if mote.latest is not None else None)
                places.setdefault(kind, []).append((mote.place.x_m, mote.place.y_m, 0.0))
        return {
            palette.MOTE_COLORS[kind]: copies(
                MOTE_MESHES[kind][0], rows(at), rows([(MOTE_MESHES[kind][1],) * 3] * len(at))
            )
            for kind, at in places.items()
        }


class ScanLayer(OwnLayer):
    """Hits of the selected robot's lidar, in the robot's colour."""

    name, label, period_s = "scans", "Lidar", 0.2

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._handle: viser.PointCloudHandle | None = None

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        robot = view.robots.get(self.focus.robot)
        points: Rows = scan_points(robot) if robot is not None else rows([])
        if robot is None or not len(points):
            if self._handle is not None:
                self._handle.remove()
                self._handle = None
            return
        color = to_linear(colors([palette.style_of(robot.index).color]))[0]
        self._handle = self.scene.add_point_cloud(
            self.node("points"), points, color, point_size=0.05, point_shape="circle", precision="float32"
        )


def scan_points(robot: ShownRobot) -> Rows:
    """Ends of the beams with a hit, float32 (N, 3), metres, arena frame."""
    pose = robot.pose_at(robot.scan.stamp_ns) if robot.scan is not None else None
    if robot.scan is None or pose is None:
        return np.empty((0, 3), np.float32)
    ranges_m = np.array(robot.scan.ranges_mm, np.float64) / 1000
    angles_rad = pose.yaw_rad + robot.scan.angle_min_rad + robot.scan.angle_increment_rad * np.arange(len(ranges_m))
    hit = ranges_m > 0
    x_m = pose.x_m + ranges_m[hit] * np.cos(angles_rad[hit])
    y_m = pose.y_m + ranges_m[hit] * np.sin(angles_rad[hit])
    return np.column_stack([x_m, y_m, np.full(x_m.shape, SCAN_Z_M)]).astype(np.float32)


def reading_text(mote: ShownMote) -> str:
    """A mote's last reading in a few characters."""
    latest = mote.latest
    return mote.name if latest is None else f"{mote.name} {latest.value:.1f}"
