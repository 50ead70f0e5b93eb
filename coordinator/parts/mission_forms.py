"""Tasks of missions, built from their steps as the tasks of a file are, and the check of whole missions."""

from collections.abc import Sequence

from robrain.client.submission import BadTask, ZoneOf, any_zone, submission_of
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.model.rules.mission import MISSION, Mission, MissionStep, check_missions
from robrain.protocol.model.rules.template import Values, fill


def task_id_of(mission_id: str, step: str, attempt: int = 1) -> str:
    """The id of a step's task, the same in every coordinator; attempts count from 1."""
    return f"{mission_id}.{step}" if attempt == 1 else f"{mission_id}.{step}.{attempt}"


def task_of_step(step: MissionStep, task_id: str, values: Values, zone_of: ZoneOf) -> TaskSubmission:
    """The task of a step.

    Args:
        step: the step.
        task_id: id of the task.
        values: for the names in its templates.
        zone_of: returns the zone of a name.

    Raises:
        BadTask: names the invalid field.

    """
    fields = fill(step.task, values)
    kind = fields.pop("kind")
    if not isinstance(kind, str):
        raise BadTask(f"expected kind as a text, got {kind}")
    return submission_of(kind, {"id": task_id, **fields}, zone_of=zone_of)


def check_steps(mission: Mission, mission_id: str, parameters: Values, zone_of: ZoneOf) -> None:
    """Check that each step of a mission is a task (ValueError); arguments as those of `task_of_step`."""
    tasks = {step.name: task_id_of(mission_id, step.name) for step in mission.steps}
    for step in mission.steps:
        try:
            task_of_step(step, tasks[step.name], {**parameters, **tasks, MISSION: mission_id}, zone_of)
        except BadTask as error:
            raise ValueError(f"mission {mission.name}, step {step.name}: task: {error}") from error


def check_files_missions(missions: Sequence[Mission]) -> None:
    """Check the missions of a file, with their default parameters (ValueError)."""
    check_missions(missions)
    for mission in missions:
        check_steps(mission, mission.name, mission.parameters, any_zone)
