"""What a robot answers when it is asked what tasks would take."""

import msgspec

from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.messages.tasks.offer_messages import TaskCost
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.tasks.task import Task
from tests.agent.desk_of_one import GOAL, YES


def test_the_desk_tells_what_tasks_would_take_and_why_it_cannot():
    desk = RobotTasks()

    def work(task: Task) -> Work:
        if task.service_s > 100:
            raise RuntimeError("too long for me")
        return Work(path_m=2.0, turn_rad=1.0, wait_s=task.service_s, radio_packets=3)

    desk.register("sweep", lambda _task: YES, lambda _why: None, work)
    sweep = Task(id="t1", kind="sweep", place=GOAL, service_s=4.0)
    assert desk.cost(sweep) == TaskCost(id="t1", path_m=2.0, turn_rad=1.0, wait_s=4.0, radio_packets=3)
    failed = desk.cost(msgspec.structs.replace(sweep, service_s=200.0))
    assert failed == TaskCost(id="t1", why="too long for me")
    unknown = desk.cost(msgspec.structs.replace(sweep, kind="fly"))
    assert "fly" in unknown.why
    desk.register("sweep", lambda _task: YES, lambda _why: None, lambda _task: Work(wait_s=1e12))
    assert desk.cost(sweep).why  # beyond what the wire carries
    assert desk.status is None
