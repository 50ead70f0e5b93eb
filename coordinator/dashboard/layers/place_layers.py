"""Places that mean something: chargers, and where tasks are to be done."""

import numpy as np
import viser

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.scene.merged_meshes import MergedMeshes, by_color, copies
from robrain.coordinator.dashboard.scene.meshes import Mesh, bolt, cube, flag, pin
from robrain.coordinator.dashboard.scene.scene_nodes import Labels, rows
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing.palette import CHARGER, CHARGER_PLATE, TASK_WAITING, Rgb, look_of
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.messages.offer_messages import TaskEvent

PLATE_M = (0.55, 0.55, 0.03)
FLAG, PIN = flag(), pin(0.16, 0.65)
TASKS = 400
TASK_LABELS = 25


class ChargerLayer(Layer):
    """Chargers: plates on the floor with a bolt above."""

    name, label, period_s = "chargers", "Chargers", 2.0

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._solids = MergedMeshes(scene, self.node("solids"))

    def _draw(self, view: TeamView, now_s: float) -> None:
        places = rows([(place.x_m, place.y_m, 0.0) for place in view.chargers])
        count = len(places)
        sizes = np.tile(np.array(PLATE_M, np.float32), (count, 1))
        bolts = copies(bolt(), places, np.ones((count, 3), np.float32))
        self._solids.show({CHARGER_PLATE: copies(cube(), places, sizes), CHARGER: bolts})


class TaskLayer(Layer):
    """Open tasks that somebody asked for: a flag waits for a robot, a pin in a robot's colour has one."""

    name, label, period_s = "tasks", "Tasks", 0.5

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._solids = MergedMeshes(scene, self.node("solids"))
        self._labels = Labels(scene, self.node("label"), 0.8, below=True)  # above are the names of robots and motes

    def _draw(self, view: TeamView, now_s: float) -> None:
        events = [event for event in view.tasks.values() if event.task.kind != "explore"][-TASKS:]
        self._solids.show(
            by_color(
                (color_of_robot(view, event.robot), _standing(PIN, event))
                if is_taken(event)
                else (TASK_WAITING, _standing(FLAG, event))
                for event in events
            )
        )
        labelled = events if len(events) <= TASK_LABELS else []
        self._labels.show(
            {
                event.task.id: (task_label(event), (place.x_m, place.y_m, 0.0))
                for event in labelled
                for place in [event.task.place]
            }
        )


def is_taken(event: TaskEvent) -> bool:
    """Whether a robot is at it."""
    return event.state in (TaskState.RUNNING, TaskState.LOST_CONTACT)


def task_label(event: TaskEvent) -> str:
    """A task in a few words."""
    who = f" {event.robot}" if event.robot and is_taken(event) else ""
    state = "lost contact" if event.state is TaskState.LOST_CONTACT else event.state.value
    return f"{event.task.kind} {state}{who}"


def color_of_robot(view: TeamView, name: str) -> Rgb:
    """The colour that a robot wears; that of waiting tasks if it is not known."""
    robot = view.robots.get(name)
    return look_of(robot.index).color if robot is not None else TASK_WAITING


def _standing(mesh: Mesh, event: TaskEvent) -> Mesh:
    place = event.task.place
    return copies(mesh, rows([(place.x_m, place.y_m, 0.0)]), np.ones((1, 3), np.float32))
