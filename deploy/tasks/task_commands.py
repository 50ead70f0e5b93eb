"""`robrain task`: submit tasks to a team, list, explain, change and cancel them."""

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_type_hints

import msgspec
import typer

from robrain.client.submission import AS_SENT, ChangeFields, TaskFields, any_zone, submission_of
from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam, Shown
from robrain.deploy.command_line.options import JsonOption, place
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.deploy.tasks.task_files import (
    REMEDIES,
    TaskWords,
    dry_run_lines,
    estimate_text,
    parameters_set,
    remedy_text,
    tasks_in,
    verdict_line,
)
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.model.tasks.task import TaskState

if TYPE_CHECKING:
    from robrain.client.team import Team

IdArgument = Annotated[str, typer.Argument(metavar="ID", help="Name of the task.")]


def line_of(record: Any) -> str:
    """A task and its state."""
    return f"{record.task.id}: {text_of(record)}"


def text_of(change: Any) -> str:
    """A task's state, robot and reason."""
    at = f" at {change.robot}" if change.robot else ""
    return f"{change.state.replace('_', ' ')}{at}{f': {change.why}' if change.why else ''}"


def show_table(records: list[Any]) -> None:
    """Tasks as a table."""
    from robrain.deploy.command_line.terminal import new_table, results
    from robrain.protocol.safe_text import safe_lines

    table = new_table("task", "kind", "state", "robot", "ends in", "priority", "by", "why")
    for record in records:
        task = record.task
        estimate = record.estimate
        ends = "" if estimate is None else f"{estimate.ends_in_s:.0f} s{', late' if estimate.is_late else ''}"
        row = (task.id, task.kind, record.state, record.robot, ends, f"{task.priority:g}", record.by, record.why)
        table.add_row(*map(safe_lines, row))
    results().print(table)


EXIT_REFUSED = 2
WITH_UNIT = {"_s": " in seconds", "_m": " in metres", "_rad": " in radians", "_dbm": " in dBm"}
SPELLED = {
    "place": "--at",
    "earliest_ns": "--earliest",
    "earliest_in_s": "--earliest",
    "deadline_ns": "--deadline",
    "deadline_in_s": "--deadline",
}
"""Options that are not named as their fields."""
POINT, WORDS = "point", "words"


class TaskOption(NamedTuple):
    """An option of `task add` for a field of a task."""

    field: str
    """Named as in the messages."""
    option: str
    form: Any
    """The type of its value; POINT for X,Y, and WORDS for an option that may be repeated."""
    help: str

    @property
    def parameter(self) -> inspect.Parameter:
        """As a parameter of the command's function."""
        plain: Any = {POINT: str, WORDS: list[str]}.get(self.form, self.form)
        annotation: Any = Annotated[plain | None, typer.Option(self.option, help=self.help)]
        return inspect.Parameter(self.field, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def option_of(field: str) -> str:
    """The option for a field of a task.

    >>> option_of("place"), option_of("until_soc"), option_of("duration_s")
    ('--at', '--until-soc', '--duration')
    """
    return SPELLED.get(field, f"--{field.removesuffix('_s').replace('_', '-')}")


def task_options() -> list[TaskOption]:
    """The options for `TaskFields`, then for the parameters of the stock kinds."""
    found = []
    for field, hint in get_type_hints(TaskFields, include_extras=True).items():
        annotated, text = get_args(hint)
        first = next(iter(get_args(annotated)), annotated)
        form = POINT if field == "place" else WORDS if field in ("needs", "after") else first
        if field != "parameters":
            sent = AS_SENT.get(field, field)
            found.append(TaskOption(sent, option_of(sent), form, text))
    kinds: dict[str, list[str]] = {}
    forms: dict[str, Any] = {}
    for kind, type_ in STOCK_KINDS.items():
        for one in msgspec.structs.fields(type_):
            kinds.setdefault(one.name, []).append(kind)
            forms[one.name] = _form_of(one.type)
    for name, those in kinds.items():
        end = next((end for end in WITH_UNIT if name.endswith(end)), "")
        what = name.removesuffix(end).replace("_", " ")
        text = f"{', '.join(those)}: {what}{WITH_UNIT.get(end, '')}{', X,Y' if forms[name] is POINT else ''}."
        found.append(TaskOption(name, option_of(name), forms[name], text))
    return found


def _form_of(hint: Any) -> Any:
    """The type that a word is read as: `float` of `Annotated[float, Meta(gt=0)] | None`."""
    while not isinstance(hint, type):
        hint = get_args(hint)[0]
    return POINT if hint is Point2D else hint


TASK_OPTIONS = task_options()
OPTIONS = {one.field: one.option for one in TASK_OPTIONS} | SPELLED
"""Command-line form of each task field."""


task_app = CommandApp(OPERATE, "task", "Submit tasks to a team; list, explain, change and cancel them.")


def _with_task_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of a task behind its argument."""
    connect, what, *rest = inspect.signature(command).parameters.values()
    own = [one for one in rest if one.kind is not inspect.Parameter.VAR_KEYWORD]
    parameters = [connect, what, *(one.parameter for one in TASK_OPTIONS), *own]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined] # which typer reads
    return command


@task_app.team_command()
@_with_task_options
def add(
    connect: ConnectTeam,
    what: Annotated[
        str, typer.Argument(metavar="KIND|FILE", help="visit, inspect, … (see `task kinds`); or a .toml or .json file.")
    ],
    *,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Any parameter of the kind, as JSON; may be repeated."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Submit nothing; print what would follow. Exit status 2 if refused.")
    ] = False,
    as_json: JsonOption = False,
    **fields: Any,
) -> None:
    """Submit a task, or the tasks in a file; an impossible task is refused at once."""
    tasks = asked_tasks(what, parameters, **fields)
    if dry_run:
        _dry_run(connect(), tasks, as_json=as_json)
        return
    records, refused, team = [], [], connect()
    for kind, given in tasks:
        try:
            records.append(team.submit(kind, id=given.pop("id", None), parameters=given))
        except CallError as error:
            refused.append(str(error))
    value = records if Path(what).suffix else records[0] if records else None
    print_either(value, map(line_of, records), as_json=as_json)
    for text in refused:
        sys.stderr.write(f"robrain: {text}\n")
    if refused:
        raise typer.Exit(EXIT_REFUSED)


def _dry_run(team: "Team", tasks: list[TaskWords], *, as_json: bool) -> None:
    """Print the expected effects of each task if it came now, without those before it in the file."""
    found = [team.dry_run(kind, id=given.pop("id", None), parameters=given) for kind, given in tasks]
    for one in found:
        print_either(one, dry_run_lines(one), as_json=as_json)
    if any(one.refused for one in found):
        raise typer.Exit(EXIT_REFUSED)


def asked_tasks(what: str, parameters: list[str] | None = None, **fields: Any) -> list[TaskWords]:
    """The tasks that the options of `task add` ask for.

    Args:
        what: a kind or a file.
        parameters: words NAME=VALUE.
        fields: values of `TASK_OPTIONS`.

    Raises:
        UsageError, BadTask: naming the option, or file and key.

    """
    given = {
        one.field: place(one.option, fields[one.field]) if one.form is POINT else fields[one.field]
        for one in TASK_OPTIONS
        if fields.get(one.field) not in (None, [], ())
    }
    given |= parameters_set(parameters or [], given)
    if Path(what).suffix in (".toml", ".json"):
        if given:
            raise UsageError(f"{what}: a file has all fields of its tasks; leave the options out")
        return tasks_in(Path(what))
    # Report mistakes before the team is contacted.
    submission_of(what, {"id": what, **given}, typed=OPTIONS, zone_of=any_zone)
    return [TaskWords(what, given)]


EXIT_NOT_DONE = 1
"""A watched task ended as failed or cancelled."""


@task_app.team_command("list")
def list_tasks(
    connect: ConnectTeam,
    state: Annotated[list[str] | None, typer.Option(help="Only tasks in this state; may be repeated.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only tasks of this kind; may be repeated.")] = None,
    robot: Annotated[str, typer.Option(help="Only tasks of this robot.")] = "",
    by: Annotated[str, typer.Option(help="Only tasks submitted by this name.")] = "",
    only_open: Annotated[bool, typer.Option("--open", help="Only tasks that have not ended.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Also tasks that the coordinator made itself.")] = False,
    limit: Annotated[int, typer.Option(help="Maximum number of tasks; the last ones are listed.", min=1)] = 1000,
    as_json: JsonOption = False,
) -> None:
    """List tasks with their states."""
    states = [_state(text) for text in state or []] or (_open_states() if only_open else [])
    wanted = TaskFilter(states=states, kinds=kind or [], robot=robot, by=by, own=everything, limit=limit)
    records = connect().list(wanted)
    print_either(records, lambda: show_table(records), as_json=as_json)


@task_app.team_command()
def kinds(connect: ConnectTeam) -> Shown:
    """List the kinds of task that the robots of the team do, with their parameters."""
    known = connect().kinds()
    lines = [] if known else ["no robot has announced its kinds of task yet"]
    for one in known:
        lines.append(f"{one.kind}: {one.doc} ({', '.join(one.robots)})")
        needed = one.parameters.get("required", [])
        for name, shape in one.parameters.get("properties", {}).items():
            meaning = shape.get("description", "") if isinstance(shape, dict) else ""
            lines.append(f"  {name}{'' if name in needed else ' (optional)'}{f': {meaning}' if meaning else ''}")
    return known, lines


@task_app.team_command()
def show(connect: ConnectTeam, task_id: IdArgument) -> Shown:
    """Print one task with all its fields."""
    record = connect().get(task_id)
    fields = {name: value for name, value in msgspec.to_builtins(record.task).items() if name != "id"}
    fields |= {f"result {name}": msgspec.json.encode(value).decode() for name, value in record.result.items()}
    texts = {
        name: value if isinstance(value, str) else msgspec.json.encode(value).decode() for name, value in fields.items()
    }
    lines = [line_of(record)] + ([] if record.estimate is None else [f"  {estimate_text(record.estimate)}"])
    lines += [f"  {name}: {text}" for name, text in texts.items()]
    return record, lines


IdsArgument = Annotated[list[str] | None, typer.Argument(metavar="[ID]...", help="Tasks, or give a filter.")]
ReasonOption = Annotated[str, typer.Option(help="Reason, for the record.")]
StateFilter = Annotated[list[str] | None, typer.Option("--state", help="Tasks in this state; may be repeated.")]
KindFilter = Annotated[list[str] | None, typer.Option("--kind", help="Tasks of this kind; may be repeated.")]
OfRobotFilter = Annotated[str, typer.Option("--of-robot", help="Tasks that this robot has.")]
ByFilter = Annotated[str, typer.Option("--by", help="Tasks submitted by this name, such as a rule's.")]
PrefixFilter = Annotated[str, typer.Option("--prefix", help="Tasks whose ids begin so.")]


@task_app.team_command()
def change(
    connect: ConnectTeam,
    task_ids: IdsArgument = None,
    state: StateFilter = None,
    kind: KindFilter = None,
    of_robot: OfRobotFilter = "",
    by: ByFilter = "",
    prefix: PrefixFilter = "",
    priority: Annotated[float | None, typer.Option(help="New priority.", min=0.0)] = None,
    deadline: Annotated[float | None, typer.Option(help="New time limit, seconds from now.", min=0.0)] = None,
    earliest: Annotated[float | None, typer.Option(help="New earliest start, seconds from now.", min=0.0)] = None,
    robot: Annotated[str, typer.Option(help="The robot that must do them from now on.")] = "",
    not_robot: Annotated[str, typer.Option(help="A robot that must not do them from now on.")] = "",
    paused: Annotated[bool | None, typer.Option("--pause/--resume", help="Paused tasks are not offered.")] = None,
    reason: ReasonOption = "",
) -> Shown:
    """Change, pause or resume open tasks; a robot gives back a task that it must not do as it was."""
    changes = ChangeFields(
        priority=priority, deadline_s=deadline, earliest_s=earliest, robot=robot, excluded=not_robot, paused=paused
    )
    if all(value in (None, "") for value in changes.values()):
        raise UsageError("expected a change, such as --priority 3 or --pause")
    changes["why"] = reason
    tasks = _selection(task_ids, state, kind, of_robot, by, prefix)
    records = connect().change(tasks, **changes)
    return records, map(line_of, records)


@task_app.team_command()
def cancel(
    connect: ConnectTeam,
    task_ids: IdsArgument = None,
    state: StateFilter = None,
    kind: KindFilter = None,
    of_robot: OfRobotFilter = "",
    by: ByFilter = "",
    prefix: PrefixFilter = "",
    reason: ReasonOption = "",
) -> Shown:
    """Cancel tasks; the robots that work on them stop."""
    tasks = _selection(task_ids, state, kind, of_robot, by, prefix)
    team = connect()
    if isinstance(tasks, TaskFilter):
        records = team.cancel_all(tasks, reason)
    else:
        records = [team.cancel(task_id, reason) for task_id in tasks]
    return records[0] if task_ids and len(records) == 1 else records, map(line_of, records)


@task_app.team_command()
def watch(
    connect: ConnectTeam,
    task_ids: Annotated[list[str] | None, typer.Argument(metavar="[ID]...", help="Default: all open tasks.")] = None,
    timeout: Annotated[float | None, typer.Option(help="Stop waiting after this many seconds.", min=0.0)] = None,
    as_json: JsonOption = False,
) -> None:
    """Print each change of tasks until they end; exit status 1 if one of them was not done."""
    not_done, team = 0, connect()
    wanted = task_ids or [record.task.id for record in team.list(TaskFilter(states=_open_states()))]
    if not wanted:
        return
    try:
        for event in team.events(wanted, timeout_s=timeout):
            print_either(event, [line_of(event)], as_json=as_json)
            not_done += event.state.ended and event.state is not TaskState.DONE
    except TimeoutError as error:
        raise UsageError(str(error)) from error
    if not_done:
        raise typer.Exit(EXIT_NOT_DONE)


@task_app.team_command("why")
def explain(connect: ConnectTeam, task_id: IdArgument) -> Shown:
    """Explain the state of a task: its conditions, its cost for each robot, and its history so far."""
    found = connect().why(task_id)
    first_ns = found.changes[0].stamp_ns if found.changes else 0
    lines = [f"{task_id}: {found.now}"]
    lines += [] if found.record.estimate is None else [f"  {estimate_text(found.record.estimate)}"]
    lines += map(remedy_text, found.remedies[:REMEDIES])
    lines += map(verdict_line, found.robots)
    lines += [f"  +{(change.stamp_ns - first_ns) / 1e9:.1f} s {text_of(change)}" for change in found.changes]
    return found, lines


@task_app.team_command()
def objective(
    connect: ConnectTeam,
    chosen: Annotated[
        Objective | None,
        typer.Argument(metavar="[energy|makespan|lifetime]", help="New objective; without it, print the current one."),
    ] = None,
) -> Shown:
    """Print or change the planning objective of the team."""
    team = connect()
    found = team.planning() if chosen is None else team.set_objective(chosen)
    text = f"{found.objective}, by {found.method}: {found.planned} planned, {found.skipped} left out"
    return found, [text]


@task_app.team_command()
def charges(connect: ConnectTeam) -> Shown:
    """Print the schedule of the chargers: which robots charge where and until when, and which wait."""
    charges = connect().planning().charges
    lines = [] if charges else ["no robot charges or is to charge"]
    for one in charges:
        at = f"({one.charger.x_m:.1f}, {one.charger.y_m:.1f})"
        words = "charges" if one.is_there else "goes to charge" if one.has_set_out else "is to charge"
        behind = f": {one.why}" if one.why else ""
        lines.append(f"{one.robot}: {words} at {at}, {one.soc:.0%} to {one.to_soc:.0%}{behind}")
    return charges, lines


def _selection(
    ids: list[str] | None, states: list[str] | None, kinds: list[str] | None, robot: str, by: str, prefix: str
) -> list[str] | TaskFilter:
    """The ids, or the filter (UsageError unless exactly one is given)."""
    is_filtered = bool(states or kinds or robot or by or prefix)
    if is_filtered == bool(ids):
        raise UsageError("expected either ids of tasks, or a filter such as --kind visit")
    found = [_state(text) for text in states or []]
    return ids or TaskFilter(states=found, kinds=kinds or [], robot=robot, by=by, prefix=prefix)


def _open_states() -> list[TaskState]:
    return [state for state in TaskState if not state.ended]


def _state(text: str) -> TaskState:
    try:
        return TaskState(text)
    except ValueError as error:
        raise UsageError(f"--state {text}: expected one of {', '.join(TaskState)}") from error
