"""What a team's coordinator is asked about the team as a whole, and about tasks that are not submitted."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from robrain.client.requests import Requests
from robrain.client.submission import dry_submission_of
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.messages.maps.left_messages import ExplorationLeft
from robrain.protocol.wire.messages.tasks.task_messages import TaskDryRun
from robrain.protocol.wire.messages.team.standing_messages import LeadRequest, RobotRemoval
from robrain.protocol.wire.standing_topics import COORDINATOR_LEAD, COORDINATOR_REMOVE_ROBOT
from robrain.protocol.wire.topics import COORDINATOR_LEFT_NOW, TASK_DRY_RUN

NO_FIELDS: Mapping[str, Any] = MappingProxyType({})


class CoordinatorAnswers:
    """Part of `Team`; see there."""

    by: str
    _requests: Requests

    def dry_run(self, task: str | Task, fields: Mapping[str, Any] = NO_FIELDS, *, id: str | None = None) -> TaskDryRun:
        """Return what would follow if a task were submitted now. Nothing is submitted.

        Args:
            task: a kind, such as `visit`, with the fields below; or a whole task.
            fields: fields and parameters of that kind, named as in the messages, such as `{"place": (3, 4)}`.
            id: the task's name; None for one that no task has.

        Raises:
            BadTask: a field is missing or invalid.
            CallError: it is no valid task.
            NobodyThere: no coordinator answers.

        """
        return self._requests.coordinator(TASK_DRY_RUN, dry_submission_of(task, id, fields, self.by))

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
