"""Result of a task if it were submitted now; nothing is written or offered."""

import msgspec

from robrain.coordinator.planning.energy_budget import UNKNOWN
from robrain.coordinator.planning.task_explanation import TaskExplanation
from robrain.coordinator.tasks.eligibility import Eligibility
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Roster
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskDryRun, TaskRecord
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import told


class DryRuns:
    """Predicts the results of tasks.

    Args:
        book: of the tasks.
        roster: the robots of the team.
        eligibility: which tasks may be offered.
        explanation: how each robot is judged.

    """

    def __init__(self, book: TaskBook, roster: Roster, eligibility: Eligibility, explanation: TaskExplanation) -> None:
        self._book, self._roster = book, roster
        self._eligibility, self._explanation = eligibility, explanation

    def of(self, task: Task, by: str, now_ns: int) -> TaskDryRun:
        """Result of a task that is admitted; its id is not in the book.

        Args:
            task: with stamps in place of times that count from now.
            by: name of the client that would submit it.
            now_ns: the time.

        """
        record = TaskRecord(task=task, state=TaskState.QUEUED, by=by, submitted_ns=now_ns)
        reason = self._eligibility.new_task_state(record, now_ns)
        robots = [self._with_costs(one, task) for one in self._explanation.judge(record, now_ns)]
        waiting = [one for one in self._book.open if not one.own and one.state is TaskState.QUEUED]
        return TaskDryRun(
            task=task,
            waits=cut(told(reason), TEXT_MAX),
            reason=reason,
            robots=robots,
            ahead=sum(one.task.priority >= task.priority for one in waiting),
        )

    def _with_costs(self, verdict: RobotVerdict, task: Task) -> RobotVerdict:
        """The verdict with the least cost of the task: a straight line, and the service time."""
        robot = self._roster.robots.get(verdict.robot)
        state = None if robot is None else robot.state
        if state is None or verdict.reason is not None or verdict.distance_m is None:
            return verdict
        time_s, energy_j = _cost(state, Work(path_m=verdict.distance_m, wait_s=task.service_s))
        return msgspec.structs.replace(verdict, time_s=round(time_s, 1), energy_j=round(energy_j, 1))


def _cost(state: RobotState, work: Work) -> tuple[float, float]:
    """Time, s, and energy, J, of work by the robot's own model, or else by that of an unknown robot."""
    if state.energy is None:
        return work.wait_s + UNKNOWN.s_per_m * work.path_m, UNKNOWN.j_per_m * work.path_m
    found = estimate(state.energy, work)
    return found.duration_s, found.mean_j
