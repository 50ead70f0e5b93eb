"""What a team's coordinator is asked about the team as a whole, and about tasks that are not submitted."""

from collections.abc import Mapping, Sequence
from typing import Any

from robrain.client.requests import Requests
from robrain.client.submission import TaskName, asked_task, id_of
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.messages.maps.left_messages import ExplorationLeft
from robrain.protocol.wire.messages.tasks.task_messages import TaskDryRun
from robrain.protocol.wire.messages.team.standing_messages import LeadRequest, RobotRemoval
from robrain.protocol.wire.standing_topics import COORDINATOR_LEAD, COORDINATOR_REMOVE_ROBOT
from robrain.protocol.wire.topics import COORDINATOR_LEFT_NOW, TASK_DRY_RUN


class CoordinatorAnswers:
    """Part of `Team`; see there."""

    by: str
    _requests: Requests

    def dry_run(
        self,
        task: str | Task,
        *,
        id: str | None = None,
        place: Point2D | Sequence[float] | None = None,
        priority: float | None = None,
        earliest_s: float | None = None,
        deadline_s: float | None = None,
        service_s: float | None = None,
        needs: Sequence[str] = (),
        after: Sequence[TaskName] = (),
        robots: int | None = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> TaskDryRun:
        """Return what would follow if `submit` were called with these arguments. Nothing is submitted.

        Raises:
            BadTask: a field is missing or invalid.
            CallError: it is no valid task.
            NobodyThere: no coordinator answers.

        """
        fields = {
            "id": id,
            "place": place,
            "priority": priority,
            "earliest_in_s": earliest_s,
            "deadline_in_s": deadline_s,
            "service_s": service_s,
            "needs": tuple(needs) or None,
            "after": tuple(map(id_of, after)) or None,
            "robots": robots,
        }
        asked = asked_task(task, self.by, f"{task}-dry-run", fields, parameters)
        return self._requests.coordinator(TASK_DRY_RUN, asked)

    def left(self) -> ExplorationLeft | None:
        """Return what exploration has left so far, by the coordinator's map; None before anything is known."""
        return self._requests.coordinator(COORDINATOR_LEFT_NOW, None)

    def lead(self, *, by: str | None = None) -> list[str]:
        """Have the coordinator offer tasks again, on your word that no other coordinator leads the silent robots.

        It offers none while it hears neither a coordinator that stood by nor more than half of its robots.

        Args:
            by: who says so, in place of the team's `by`.

        Returns:
            Names of the silent robots that count no more until they are heard again.

        """
        return self._requests.coordinator(COORDINATOR_LEAD, LeadRequest(by=self.by if by is None else by)).left_out

    def remove_robot(self, robot: str) -> None:
        """Have the coordinator forget a robot that has gone; until then it is shown as gone.

        Raises:
            CallError: the robot is unknown, is there, or may still do a task.

        """
        self._requests.coordinator(COORDINATOR_REMOVE_ROBOT, RobotRemoval(robot=robot, by=self.by))
