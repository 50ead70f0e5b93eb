"""One robot does a task of each kind, one after the other; two do tasks at random."""

import numpy as np
import pytest

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.plugins.behavior.errands import BEHAVIORS, CHARGER, MOTES, Errands

pytestmark = pytest.mark.slow

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


def test_whatever_two_robots_are_asked_for_ends_and_they_do_not_meet():
    """Tasks at random, one in three before the last one has ended, one in five taken back on the way."""
    run = Errands(*BEHAVIORS, "explore", seed=16, starts={"r2": Pose2D(4.8, 3.2, 0.0)})
    run.run(1.0)
    rng = np.random.default_rng(16)
    for number in range(8):
        robot = ("r1", "r2")[number % 2]
        task = random_task(f"t{number}", rng)
        if not run.offer(task, robot).accepted:
            continue
        if rng.random() < 0.2:
            run.run(2.0)
            run.withdraw(task.id, robot)
        if rng.random() < 0.66:
            run.run_until(lambda robot=robot: run.status(robot).state.ended, 120.0, 0.5)
    run.run_until(
        lambda: all(run.status(host.name).state.ended and host.board.behavior == "idle" for host in run.hosts),
        150.0,
        1.0,
    )
    assert run.arena.collisions == 0
    run.close()


def random_task(name: str, rng: np.random.Generator) -> Task:
    place = Point2D(rng.uniform(0.5, 5.5), rng.uniform(0.5, 3.5))
    made: tuple[Task, ...] = (
        Task(id=name, kind="visit", place=place, service_s=rng.uniform(0.0, 5.0)),
        Task(id=name, kind="explore", place=place),
        Task(id=name, kind="inspect", place=place, parameters={"look_at": MOTES[1]}),
        Task(id=name, kind="collect", place=place, parameters={"mote": f"m{rng.integers(1, 4)}", "timeout_s": 10.0}),
        Task(
            id=name,
            kind="relay",
            place=place,
            parameters={"mote": "m1", "duration_s": 10.0, "rssi_min_dbm": rng.uniform(-95.0, -40.0)},
        ),
        Task(id=name, kind="monitor", place=place, parameters={"duration_s": 12.0, "interval_s": 6.0, "views": 2}),
        Task(id=name, kind="sense", place=place, parameters={"mote": ("", "m1")[rng.integers(2)], "timeout_s": 8.0}),
        Task(id=name, kind="replace", place=place, parameters={"mote": "m2", "duration_s": 5.0, "period_s": 2.0}),
        Task(id=name, kind="recharge", place=CHARGER, parameters={"until_soc": 0.5}),
    )
    return made[rng.integers(len(made))]
