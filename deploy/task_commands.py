"""`robrain task`: have a team do things, see how they stand and why, and call them off."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robrain.protocol.model.objective import Objective
from robrain.protocol.wire.keys import DEFAULT_TEAM

if TYPE_CHECKING:
    from robrain.deploy.task_client import TaskClient
    from robrain.protocol.model.task import TaskState

EXIT_NOT_DONE = 1
"""A task that was watched has ended otherwise than done."""
EXIT_REFUSED = 2

task_app = typer.Typer(
    name="task",
    help="Have a team do tasks; see how they stand, and why.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ConnectOption = Annotated[
    str | None, typer.Option(help="Endpoint of the team, tcp/HOST:PORT; default is $ROBRAIN_CONNECT.")
]
TeamOption = Annotated[str, typer.Option(help="Name of the team.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on stdout and nothing else.")]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="Name of the task.")]


@task_app.command()
def add(
    what: Annotated[str, typer.Argument(metavar="KIND|FILE", help="visit, inspect, …; or a .toml or .json file.")],
    at: Annotated[str | None, typer.Option(help="Where: X,Y in metres, arena frame.")] = None,
    task_id: Annotated[str | None, typer.Option("--id", help="Its name; the same task again counts once.")] = None,
    priority: Annotated[float | None, typer.Option(help="The prize for doing it; 1 if not given.")] = None,
    deadline: Annotated[float | None, typer.Option(help="It must be done in so many seconds.")] = None,
    earliest: Annotated[float | None, typer.Option(help="It must not begin before so many seconds have gone.")] = None,
    service: Annotated[float | None, typer.Option(help="How long it takes at its place, in seconds.")] = None,
    needs: Annotated[list[str] | None, typer.Option(help="A plugin that the robot must have; may be repeated.")] = None,
    after: Annotated[list[str] | None, typer.Option(help="A task that must be done before; may be repeated.")] = None,
    robots: Annotated[int | None, typer.Option(help="So many robots at once; 1 if not given.", min=1)] = None,
    mote: Annotated[str | None, typer.Option(help="collect, relay, sense, replace: which mote.")] = None,
    duration: Annotated[float | None, typer.Option(help="relay, monitor, replace: for how long, in seconds.")] = None,
    interval: Annotated[float | None, typer.Option(help="monitor: seconds from round to round.")] = None,
    quantity: Annotated[str | None, typer.Option(help="sense: what is measured.")] = None,
    look_at: Annotated[str | None, typer.Option(help="inspect: X,Y of what is to be in the picture.")] = None,
    until_soc: Annotated[float | None, typer.Option(help="recharge: state of charge to reach, to 1.")] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Ask for a task, or for those in a file. Refused at once if it can never be done."""
    from robrain.deploy.errors import UsageError
    from robrain.deploy.task_words import point, submission_of, submissions_in
    from robrain.protocol.wire.errors import CallError

    place = "goal" if what == "explore" else "place"
    fields: dict[str, Any] = {
        place: point("--at", at) if at is not None else None,
        "id": task_id,
        "priority": priority,
        "deadline_in_s": deadline,
        "earliest_in_s": earliest,
        "service_s": service,
        "needs": needs or None,
        "after": after or None,
        "robots": robots,
        "mote": mote,
        "duration_s": duration,
        "interval_s": interval,
        "quantity": quantity,
        "look_at": point("--look-at", look_at) if look_at is not None else None,
        "until_soc": until_soc,
    }
    given = {name: value for name, value in fields.items() if value is not None}
    if Path(what).suffix in (".toml", ".json"):
        if given:
            raise UsageError(f"{what}: a file says all about its tasks itself; leave the options out")
        submissions = submissions_in(Path(what))
    else:
        submissions = [submission_of(what, given)]
    records, refused = [], []
    with _client(connect, team) as client:
        for asked in submissions:
            try:
                records.append(
                    client.submit(asked.task, earliest_in_s=asked.earliest_in_s, deadline_in_s=asked.deadline_in_s)
                )
            except CallError as error:
                refused.append(str(error))
    if as_json:
        _print_json(records if Path(what).suffix else records[0] if records else None)
    else:
        for record in records:
            _say(_line(record))
    for text in refused:
        sys.stderr.write(f"robrain: {text}\n")
    if refused:
        raise typer.Exit(EXIT_REFUSED)


@task_app.command("list")
def list_tasks(
    state: Annotated[list[str] | None, typer.Option(help="Only those in this state; may be repeated.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only those of this kind; may be repeated.")] = None,
    robot: Annotated[str, typer.Option(help="Only those of this robot.")] = "",
    by: Annotated[str, typer.Option(help="Only those that this one asked for.")] = "",
    only_open: Annotated[bool, typer.Option("--open", help="Only those that have not ended.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Those, too, that the coordinator made itself.")] = False,
    limit: Annotated[int, typer.Option(help="The last so many.", min=1)] = 1000,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Say which tasks there are and how they stand."""
    from robrain.deploy.task_client import open_states
    from robrain.protocol.wire.task_messages import TaskFilter

    states = [_state(text) for text in state or []] or (open_states() if only_open else [])
    wanted = TaskFilter(states=states, kinds=kind or [], robot=robot, by=by, own=everything, limit=limit)
    with _client(connect, team) as client:
        records = client.list(wanted)
    if as_json:
        _print_json(records)
    else:
        _show(records)


@task_app.command()
def show(
    task_id: IdArgument, connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False
) -> None:
    """Say all there is to say of one task."""
    import msgspec

    with _client(connect, team) as client:
        record = client.get(task_id)
    if as_json:
        _print_json(record)
        return
    _say(_line(record))
    for name, value in msgspec.to_builtins(record.task).items():
        if name != "id":
            _say(f"  {name}: {value if isinstance(value, str) else msgspec.json.encode(value).decode()}")
    for name, value in record.result.items():
        _say(f"  result {name}: {msgspec.json.encode(value).decode()}")


@task_app.command()
def cancel(
    task_id: IdArgument,
    reason: Annotated[str, typer.Option(help="Why.")] = "",
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Call a task off; a robot that is at it is told to stop."""
    with _client(connect, team) as client:
        record = client.cancel(task_id, reason)
    if as_json:
        _print_json(record)
    else:
        _say(_line(record))


@task_app.command()
def watch(
    task_ids: Annotated[list[str] | None, typer.Argument(metavar="[ID]...", help="Default: all that are open.")] = None,
    timeout: Annotated[float | None, typer.Option(help="Give up after so many seconds.", min=0.0)] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Print each change of tasks until they end; exit status 1 if one of them was not done."""
    from robrain.deploy.errors import UsageError
    from robrain.deploy.task_client import open_states
    from robrain.protocol.model.task import TaskState
    from robrain.protocol.wire.task_messages import TaskFilter

    not_done = 0
    with _client(connect, team) as client:
        wanted = list(task_ids or [])
        if not wanted:
            wanted = [record.task.id for record in client.list(TaskFilter(states=open_states()))]
        if not wanted:
            return
        try:
            for event in client.events(wanted, timeout_s=timeout):
                if as_json:
                    _print_json(event)
                else:
                    _say(_line(event))
                not_done += event.state.ended and event.state is not TaskState.DONE
        except TimeoutError as error:
            raise UsageError(str(error)) from error
    if not_done:
        raise typer.Exit(EXIT_NOT_DONE)


@task_app.command()
def why(
    task_id: IdArgument, connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False
) -> None:
    """Say why a task stands as it does: what it waits for, what each robot would need, what happened so far."""
    with _client(connect, team) as client:
        found = client.why(task_id)
    if as_json:
        _print_json(found)
        return
    _say(f"{task_id}: {found.now}")
    for verdict in found.robots:
        words = [f"{verdict.distance_m:.1f} m away"] if verdict.distance_m is not None else []
        words += [f"{verdict.time_s:.0f} s"] if verdict.time_s is not None else []
        words += [f"{verdict.energy_j:.0f} J"] if verdict.energy_j is not None else []
        words += ["chosen"] if verdict.chosen else [verdict.why_not] if verdict.why_not else []
        _say(f"  {verdict.robot}: {', '.join(words)}")
    first_ns = found.changes[0].stamp_ns if found.changes else 0
    for change in found.changes:
        _say(f"  +{(change.stamp_ns - first_ns) / 1e9:.1f} s {_words(change)}")


@task_app.command()
def objective(
    chosen: Annotated[
        Objective | None, typer.Argument(metavar="[energy|makespan|lifetime]", help="From now on.")
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Say what the team's plans are to be good at, or have them be good at something else."""
    with _client(connect, team) as client:
        found = client.planning(chosen)
    if as_json:
        _print_json(found)
        return
    _say(f"{found.objective}, by {found.method}: {found.planned} planned, {found.left_out} left out")


def _client(connect: str | None, team: str) -> "TaskClient":
    from robrain.deploy.task_client import TaskClient

    return TaskClient(connect, team=team, by=os.environ.get("USER", ""))


def _state(text: str) -> "TaskState":
    from robrain.deploy.errors import UsageError
    from robrain.protocol.model.task import TaskState

    try:
        return TaskState(text)
    except ValueError as error:
        raise UsageError(f"--state {text}: expected one of {', '.join(TaskState)}") from error


def _line(record: Any) -> str:
    return f"{record.task.id}: {_words(record)}"


def _words(change: Any) -> str:
    at = f" at {change.robot}" if change.robot else ""
    return f"{change.state.replace('_', ' ')}{at}{f': {change.why}' if change.why else ''}"


def _show(records: list[Any]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from robrain.deploy.plugin_commands import PLAIN_WIDTH
    from robrain.protocol.model.task import kind_of

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PLAIN_WIDTH)
    table = Table(box=None, pad_edge=False)
    for heading in ("task", "kind", "state", "robot", "priority", "by", "why"):
        table.add_column(heading, overflow="fold")
    for record in records:
        task = record.task
        row = (task.id, kind_of(task), record.state, record.robot, f"{task.priority:g}", record.by, record.why)
        table.add_row(*map(escape, row))
    console.print(table)


def _print_json(value: object) -> None:
    import msgspec

    _say(msgspec.json.encode(value).decode())


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
