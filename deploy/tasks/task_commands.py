"""`robrain task`: submit tasks to a team, list, explain and cancel them."""

from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.team_options import ConnectOption, TeamOption, connect_team, print_json, say
from robrain.deploy.tasks.dry_run_words import verdict_line
from robrain.deploy.tasks.task_adding import add
from robrain.deploy.tasks.task_terminal import IdArgument, JsonOption, line_of, show_table, text_of
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.model.tasks.objective import Objective

if TYPE_CHECKING:
    from robrain.protocol.model.tasks.task import TaskState

EXIT_NOT_DONE = 1
"""A watched task ended as failed or cancelled."""

task_app = typer.Typer(
    name="task",
    help="Submit tasks to a team; list, explain and cancel them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
task_app.command()(add)


@task_app.command("list")
def list_tasks(
    state: Annotated[list[str] | None, typer.Option(help="Only tasks in this state; may be repeated.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only tasks of this kind; may be repeated.")] = None,
    robot: Annotated[str, typer.Option(help="Only tasks of this robot.")] = "",
    by: Annotated[str, typer.Option(help="Only tasks submitted by this name.")] = "",
    only_open: Annotated[bool, typer.Option("--open", help="Only tasks that have not ended.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Also tasks that the coordinator made itself.")] = False,
    limit: Annotated[int, typer.Option(help="Maximum number of tasks; the last ones are listed.", min=1)] = 1000,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """List tasks with their states."""
    from robrain.protocol.messages.tasks.task_messages import TaskFilter

    states = [_state(text) for text in state or []] or (_open_states() if only_open else [])
    wanted = TaskFilter(states=states, kinds=kind or [], robot=robot, by=by, own=everything, limit=limit)
    with connect_team(connect, team) as client:
        records = client.list(wanted)
    if as_json:
        print_json(records)
    else:
        show_table(records)


@task_app.command()
def kinds(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """List the kinds of task that the robots of the team do, with their parameters."""
    with connect_team(connect, team) as client:
        known = client.kinds()
    if as_json:
        print_json(known)
        return
    if not known:
        say("no robot has announced its kinds of task yet")
    for one in known:
        say(f"{one.kind}: {one.doc} ({', '.join(one.robots)})")
        needed = one.parameters.get("required", [])
        for name, shape in one.parameters.get("properties", {}).items():
            meaning = shape.get("description", "") if isinstance(shape, dict) else ""
            say(f"  {name}{'' if name in needed else ' (optional)'}{f': {meaning}' if meaning else ''}")


@task_app.command()
def show(
    task_id: IdArgument, connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False
) -> None:
    """Print one task with all its fields."""
    import msgspec

    with connect_team(connect, team) as client:
        record = client.get(task_id)
    if as_json:
        print_json(record)
        return
    say(line_of(record))
    for name, value in msgspec.to_builtins(record.task).items():
        if name != "id":
            say(f"  {name}: {value if isinstance(value, str) else msgspec.json.encode(value).decode()}")
    for name, value in record.result.items():
        say(f"  result {name}: {msgspec.json.encode(value).decode()}")


@task_app.command()
def cancel(
    task_id: IdArgument,
    reason: Annotated[str, typer.Option(help="Reason, for the record.")] = "",
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Cancel a task; the robot that works on it is told to stop."""
    with connect_team(connect, team) as client:
        record = client.cancel(task_id, reason)
    if as_json:
        print_json(record)
    else:
        say(line_of(record))


@task_app.command()
def watch(
    task_ids: Annotated[list[str] | None, typer.Argument(metavar="[ID]...", help="Default: all open tasks.")] = None,
    timeout: Annotated[float | None, typer.Option(help="Stop waiting after this many seconds.", min=0.0)] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Print each change of tasks until they end; exit status 1 if one of them was not done."""
    from robrain.deploy.errors import UsageError
    from robrain.protocol.messages.tasks.task_messages import TaskFilter
    from robrain.protocol.model.tasks.task import TaskState

    not_done = 0
    with connect_team(connect, team) as client:
        wanted = list(task_ids or [])
        if not wanted:
            wanted = [record.task.id for record in client.list(TaskFilter(states=_open_states()))]
        if not wanted:
            return
        try:
            for event in client.events(wanted, timeout_s=timeout):
                if as_json:
                    print_json(event)
                else:
                    say(line_of(event))
                not_done += event.state.ended and event.state is not TaskState.DONE
        except TimeoutError as error:
            raise UsageError(str(error)) from error
    if not_done:
        raise typer.Exit(EXIT_NOT_DONE)


@task_app.command()
def why(
    task_id: IdArgument, connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False
) -> None:
    """Explain the state of a task: what it waits for, what it would cost each robot, what has happened so far."""
    with connect_team(connect, team) as client:
        found = client.why(task_id)
    if as_json:
        print_json(found)
        return
    say(f"{task_id}: {found.now}")
    for verdict in found.robots:
        say(verdict_line(verdict))
    first_ns = found.changes[0].stamp_ns if found.changes else 0
    for change in found.changes:
        say(f"  +{(change.stamp_ns - first_ns) / 1e9:.1f} s {text_of(change)}")


@task_app.command()
def objective(
    chosen: Annotated[
        Objective | None,
        typer.Argument(metavar="[energy|makespan|lifetime]", help="New objective; without it, print the current one."),
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Print or change the planning objective of the team."""
    with connect_team(connect, team) as client:
        found = client.planning() if chosen is None else client.set_objective(chosen)
    if as_json:
        print_json(found)
        return
    say(f"{found.objective}, by {found.method}: {found.planned} planned, {found.left_out} left out")


@task_app.command()
def charges(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """Print the schedule of the chargers: which robots charge where and until when, and which wait."""
    with connect_team(connect, team) as client:
        found = client.planning()
    if as_json:
        print_json(found.charges)
        return
    if not found.charges:
        say("no robot charges or is to charge")
    for one in found.charges:
        at = f"({one.charger.x_m:.1f}, {one.charger.y_m:.1f})"
        words = "charges" if one.is_there else "goes to charge" if one.has_set_out else "is to charge"
        behind = f": {one.why}" if one.why else ""
        say(f"{one.robot}: {words} at {at}, {one.soc:.0%} to {one.to_soc:.0%}{behind}")


def _open_states() -> "list[TaskState]":
    from robrain.protocol.model.tasks.task import TaskState

    return [state for state in TaskState if not state.ended]


def _state(text: str) -> "TaskState":
    from robrain.deploy.errors import UsageError
    from robrain.protocol.model.tasks.task import TaskState

    try:
        return TaskState(text)
    except ValueError as error:
        raise UsageError(f"--state {text}: expected one of {', '.join(TaskState)}") from error
