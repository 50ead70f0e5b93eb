"""Tasks from a kind and its fields; each mistake is one sentence."""

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, TypedDict

import msgspec

from robrain.protocol.errors import BadName, RobrainError
from robrain.protocol.keys import check_name
from robrain.protocol.messages.tasks.task_messages import TaskRecord, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS, check_parameters
from robrain.protocol.model.tasks.task import BadParameters, Task
from robrain.protocol.model.zone import Zone, ZoneKind


class BadTask(RobrainError):
    """An invalid task: unknown kind, or a field that is missing or invalid; the text names the expected value."""


TaskName = str | TaskRecord
"""A task by its id, or by any record of it."""


class TaskFields(TypedDict, total=False):
    """Fields of a task besides its kind, as people and scripts give them; each form of a task is made of this.

    Parameters of the kind, named as in the messages, such as `{"look_at": (5, 1)}`, are in `parameters`.
    """

    place: Annotated[Point2D | Sequence[float] | str | None, "Place: X,Y in metres, arena frame; or a zone's name."]
    id: Annotated[str | None, "Name; the same task again is not repeated."]
    priority: Annotated[float | None, "Reward for doing it; 1 if not given."]
    deadline_s: Annotated[float | None, "Time limit, seconds from acceptance."]
    earliest_s: Annotated[float | None, "Earliest start, seconds from acceptance."]
    service_s: Annotated[float | None, "Duration at its place, seconds."]
    needs: Annotated[Sequence[str], "A plugin that the robot must have, or the robot's name; may be repeated."]
    after: Annotated[Sequence[TaskName], "A task that must be done before; may be repeated."]
    same_robot_as: Annotated[str | None, "A task whose robot is to do this one too."]
    robots: Annotated[int | None, "Number of robots at the same time; 1 if not given."]
    parameters: Annotated[Mapping[str, Any] | None, "Parameters of the kind."]


class ChangeFields(TypedDict, total=False):
    """Changes of submitted tasks, for `Team.change`; None, or an empty text, changes nothing."""

    priority: float | None
    deadline_s: float | None
    earliest_s: float | None
    robot: str
    excluded: str
    paused: bool | None
    why: str


POINTS = ("place", "look_at", "to")
ITEM_POINTS = ("pick_up", "to")
"""Points of each of a delivery's `items`."""
POINT_LISTS = ("stops", "area")
RELATIVE = ("earliest_in_s", "deadline_in_s")
AS_SENT = {"earliest_s": "earliest_in_s", "deadline_s": "deadline_in_s"}
"""Names in the messages of fields that have another name in `TaskFields`."""
ENGLISH = ("id", "needs", "after", "robots")
"""Fields whose names are also English words."""
COMMON = frozenset(field.name for field in msgspec.structs.fields(Task)) - {"kind", "parameters"}
AS_ON_THE_WIRE: Mapping[str, str] = MappingProxyType({})
"""Scripts and task files use the field names of the messages."""


ZoneOf = Callable[[str], Zone]
"""Returns the zone of a name, or raises BadTask."""


def any_zone(name: str) -> Zone:
    """For checks before the team is contacted, whose result is discarded: any name is accepted."""
    return Zone(name=name, kind=ZoneKind.PLACE, corners_m=((0.0, 0.0),) * 3)


def no_zone(name: str) -> Zone:
    """Where no team is at hand, names are refused."""
    raise BadTask(f"expected x and y in metres, got the name {name}")


def submission_of(
    kind: str,
    fields: Mapping[str, Any],
    where: str = "",
    typed: Mapping[str, str] = AS_ON_THE_WIRE,
    zone_of: ZoneOf = no_zone,
) -> TaskSubmission:
    """Build a task request from a kind and its fields, named as in the messages.

    Args:
        kind: the task's. The parameters of a kind that is not robrain's own are checked by the coordinator, which
            knows them from the robots.
        fields: the given fields and parameters, with an `id`; `earliest_in_s` and `deadline_in_s` count from now. A
            point may be two numbers.
        where: file and number of the task, for the error message.
        typed: command-line form of fields that are not typed by their name.
        zone_of: returns the zone of a name: its centre stands for a point, its corners for an area.

    Raises:
        BadTask: names the invalid field.

    """
    known = STOCK_KINDS.get(kind)
    allowed = COMMON | ({field.name for field in msgspec.structs.fields(known)} if known is not None else set())
    content = dict(fields)
    for name in content:
        if known is not None and name not in allowed and name not in RELATIVE:
            known_as = sorted({typed.get(field, field) for field in allowed})
            raise BadTask(f"{where}a task to {kind} has no {typed.get(name, name)}; it has {', '.join(known_as)}")

    def point(name: str, at: Any) -> Any:
        if isinstance(at, str):
            return zone_of(at).centre
        if not isinstance(at, list | tuple):
            return at
        if len(at) != 2:
            raise BadTask(f"{where}expected {name} as two numbers, x and y in metres; got {at!r}")
        return {"x_m": at[0], "y_m": at[1]}

    if isinstance(content.get("area"), str):
        zone = zone_of(content["area"])
        content = {"place": zone.centre, **content, "area": zone.corners_m}
    content |= {name: point(name, content[name]) for name in POINTS if name in content}
    if isinstance(content.get("items"), list | tuple):
        content["items"] = [
            {name: point(name, value) if name in ITEM_POINTS else value for name, value in item.items()}
            if isinstance(item, dict)
            else item
            for item in content["items"]
        ]
    for name in POINT_LISTS:
        if isinstance(content.get(name), list | tuple):
            content[name] = [point(name, at) for at in content[name]]
    times = {name: content.pop(name) for name in RELATIVE if name in content}
    parameters = {name: content.pop(name) for name in list(content) if name not in COMMON}
    asked = {"task": {**content, "kind": kind, "parameters": parameters}, **times}
    try:
        submission = msgspec.convert(msgspec.to_builtins(asked), TaskSubmission)
        check_name("task", submission.task.id)
        check_parameters(submission.task)
    except BadParameters as error:
        raise BadTask(f"{where}{error.words(_typed(error.field, typed))}") from error
    except (msgspec.ValidationError, TypeError) as error:
        raise BadTask(f"{where}{_words(str(error), kind, typed)}") from error
    except BadName as error:
        option = f"{typed['id']}: " if "id" in typed else ""
        raise BadTask(f"{where}{option}{error}") from error
    return submission


def asked_task(task: str | Task, by: str, new_id: str, fields: TaskFields, zone_of: ZoneOf) -> TaskSubmission:
    """Build the request of `Team.submit` and `Team.dry_run` from their arguments.

    Args:
        task: a kind or a whole task.
        by: name of the client.
        new_id: id of the task if the fields have none.
        fields: the arguments; those that are None or empty are not given.
        zone_of: returns the zone of a name: its centre stands for a point, its corners for an area.

    Raises:
        BadTask: a field is missing, invalid or given twice, or a whole task has further fields than times.

    """
    given: dict[str, Any] = {
        AS_SENT.get(name, name): value
        for name, value in fields.items()
        if value is not None and (value or name not in ("needs", "after"))
    }
    parameters = given.pop("parameters", {})
    if not isinstance(task, str):
        times = {name: given.pop(name) for name in RELATIVE if name in given}
        if given or parameters:
            names = ", ".join(sorted([*given, *parameters]))
            raise BadTask(f"task {task.id} is whole already: leave out {names}")
        return TaskSubmission(task=task, by=by, **times)
    if twice := sorted({*given, "id"} & parameters.keys()):
        raise BadTask(f"a task to {task}: give {', '.join(twice)} as an argument, not among the parameters")
    if "after" in given:
        given["after"] = [id_of(one) for one in given["after"]]
    return msgspec.structs.replace(submission_of(task, {"id": new_id, **given, **parameters}, zone_of=zone_of), by=by)


def id_of(task: TaskName) -> str:
    """The id of a task."""
    return task if isinstance(task, str) else task.task.id


def _typed(path: str, typed: Mapping[str, str]) -> str:
    field, dot, rest = path.partition(".")
    return f"{typed.get(field, field)}{dot}{rest}"


def _words(text: str, kind: str, typed: Mapping[str, str]) -> str:
    text, _, place = text.partition(" - at `$.")
    name = place.rstrip("`").removeprefix("task.").removeprefix("task")
    missing = text.removeprefix("Object missing required field ")
    if missing != text:
        return f"a task to {kind} needs {_typed(missing.strip('`'), typed)}"
    if name:
        return f"{_typed(name, typed)}: {text}"
    # Errors of the task's type name fields within English text, where "after" is also a plain word.
    return re.sub(r"\w+", lambda word: typed.get(word[0], word[0]) if word[0] not in ENGLISH else word[0], text)
