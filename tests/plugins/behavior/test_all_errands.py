"""One robot does a task of each kind, one after the other; two do tasks at random."""

import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.plugins.behavior.errands import BEHAVIORS, CHARGER, MOTES, Errands

pytestmark = pytest.mark.slow

AREA = [{"x_m": x_m, "y_m": y_m} for x_m, y_m in ((4.0, 2.6), (5.2, 2.6), (5.2, 3.4), (4.0, 3.4))]
TASKS: tuple[Task, ...] = (
    Task(id="visit", kind="visit", place=Point2D(3.0, 3.2), service_s=1.0),
    Task(id="explore", kind="explore", place=Point2D(5.6, 2.0)),
    Task(id="inspect", kind="inspect", place=Point2D(2.0, 2.5), parameters={"look_at": MOTES[2]}),
    Task(id="collect", kind="collect", place=MOTES[2], parameters={"mote": "m2"}),
    Task(id="relay", kind="relay", place=Point2D(4.0, 3.0), parameters={"mote": "m1", "duration_s": 10.0}),
    Task(
        id="monitor",
        kind="monitor",
        place=Point2D(2.0, 2.0),
        parameters={"duration_s": 12.0, "interval_s": 6.0, "views": 2},
    ),
    Task(id="patrol", kind="patrol", place=Point2D(3.0, 2.0), parameters={"stops": [{"x_m": 5.0, "y_m": 3.0}]}),
    Task(id="deliver", kind="deliver", place=Point2D(2.0, 3.2), parameters={"to": {"x_m": 3.0, "y_m": 3.2}}),
    Task(id="sweep", kind="sweep", place=Point2D(4.0, 2.6), parameters={"area": AREA, "width_m": 0.6}),
    Task(id="follow", kind="follow", place=Point2D(3.0, 3.2), parameters={"duration_s": 3.0}),
    Task(id="guard", kind="guard", place=Point2D(3.0, 3.2), parameters={"area": AREA, "duration_s": 2.0}),
    Task(id="sense", kind="sense", place=Point2D(4.5, 2.4)),
    Task(id="seek", kind="seek", place=Point2D(3.0, 3.2), parameters={"reach_m": 4.0, "duration_s": 240.0}),
    Task(id="replace", kind="replace", place=MOTES[1], parameters={"mote": "m1", "duration_s": 6.0, "period_s": 2.0}),
    Task(id="recharge", kind="recharge", place=CHARGER, parameters={"yaw_rad": 0.0, "until_soc": 0.5}),
)


def test_one_robot_does_each_kind_of_task():
    run = Errands(*BEHAVIORS, "explore", seed=1, parameters={"idle": {"home": [1.0, 1.0]}})
    run.run(1.0)
    ends = {task.kind: run.finish(task).state for task in TASKS}
    run.call("wander", "start", 4.0)
    run.run(5.0)
    assert ends == {task.kind: TaskState.DONE for task in TASKS}
    assert run.arena.collisions == 0
    run.close()
