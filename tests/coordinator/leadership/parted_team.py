"""A team some of whose robots are out of the coordinator's reach."""

from robrain.protocol.messages.tasks.task_messages import TASK_EXPLAIN, TaskExplanation, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from tests.coordinator.conftest import Team


class PartedTeam(Team):
    """Robots that can visit places, in a row."""

    def __init__(self, session, robots: int) -> None:
        super().__init__(session)
        for number in range(robots):
            self.robot(f"r{number + 1}", 4.0 + number).plugins = ["visit"]

    def part(self, *robots: str) -> None:
        """These robots are not heard, all others are."""
        for robot in self.robots:
            robot.speaks = robot.name not in robots

    def queue(self, name: str, x_m: float = 5.0) -> None:
        """A task is queued, without waiting for any disk."""
        self.coordinator.tasks.add(Task(id=name, kind="visit", place=Point2D(x_m, 4.0)), by="ann")

    def asked(self) -> list[str]:
        """Tasks that robots were offered."""
        return [offer.task.id for robot in self.robots for offer in robot.offers]

    def why_waiting(self, task_id: str) -> object:
        return self.ask(TASK_EXPLAIN, TaskRequest(id=task_id), TaskExplanation).reason
