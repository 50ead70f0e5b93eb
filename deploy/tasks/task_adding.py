"""`robrain task add`: submit tasks."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robrain.deploy.command_line.team_options import ConnectOption, TeamOption, connect_team, print_json, say
from robrain.deploy.tasks.task_terminal import JsonOption, line_of
from robrain.protocol.keys import DEFAULT_TEAM

if TYPE_CHECKING:
    from robrain.deploy.tasks.task_files import TaskWords

EXIT_REFUSED = 2
OPTIONS = {
    "place": "--at",
    "id": "--id",
    "priority": "--priority",
    "deadline_ns": "--deadline",
    "deadline_in_s": "--deadline",
    "earliest_ns": "--earliest",
    "earliest_in_s": "--earliest",
    "service_s": "--service",
    "needs": "--needs",
    "after": "--after",
    "robots": "--robots",
    "mote": "--mote",
    "robot": "--robot",
    "duration_s": "--duration",
    "interval_s": "--interval",
    "quantity": "--quantity",
    "look_at": "--look-at",
    "until_soc": "--until-soc",
}
"""Command-line form of each task field."""


def add(
    what: Annotated[
        str, typer.Argument(metavar="KIND|FILE", help="visit, inspect, … (see `task kinds`); or a .toml or .json file.")
    ],
    at: Annotated[str | None, typer.Option(help="Place: X,Y in metres, arena frame.")] = None,
    task_id: Annotated[str | None, typer.Option("--id", help="Name; the same task again is not repeated.")] = None,
    priority: Annotated[float | None, typer.Option(help="Reward for doing it; 1 if not given.")] = None,
    deadline: Annotated[float | None, typer.Option(help="Time limit, seconds from acceptance.")] = None,
    earliest: Annotated[float | None, typer.Option(help="Earliest start, seconds from acceptance.")] = None,
    service: Annotated[float | None, typer.Option(help="Duration at its place, seconds.")] = None,
    needs: Annotated[list[str] | None, typer.Option(help="A plugin that the robot must have; may be repeated.")] = None,
    after: Annotated[list[str] | None, typer.Option(help="A task that must be done before; may be repeated.")] = None,
    robots: Annotated[
        int | None, typer.Option(help="Number of robots at the same time; 1 if not given.", min=1)
    ] = None,
    mote: Annotated[str | None, typer.Option(help="collect, relay, sense, replace: name of the mote.")] = None,
    robot: Annotated[
        str | None, typer.Option(help="relay: the robot to link to, such as the next one of a chain.")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="relay, monitor, replace, seek: duration in seconds.")] = None,
    interval: Annotated[float | None, typer.Option(help="monitor: seconds between rounds.")] = None,
    quantity: Annotated[str | None, typer.Option(help="sense, seek: quantity to measure.")] = None,
    look_at: Annotated[str | None, typer.Option(help="inspect: point to look at, X,Y.")] = None,
    until_soc: Annotated[float | None, typer.Option(help="recharge: state of charge to reach, up to 1.")] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Any parameter of the kind, as JSON; may be repeated."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Submit nothing; print what would follow. Exit status 2 if refused.")
    ] = False,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Submit a task, or the tasks in a file; an impossible task is refused at once."""
    from robrain.protocol.errors import CallError

    tasks = asked_tasks(
        what, at=at, task_id=task_id, priority=priority, deadline=deadline, earliest=earliest, service=service,
        needs=needs, after=after, robots=robots, mote=mote, robot=robot, duration=duration, interval=interval,
        quantity=quantity, look_at=look_at, until_soc=until_soc, parameters=parameters,
    )  # fmt: skip
    if dry_run:
        _dry_run(tasks, connect, team, as_json=as_json)
        return
    records, refused = [], []
    with connect_team(connect, team) as client:
        for kind, fields in tasks:
            try:
                records.append(client.submit(kind, id=fields.pop("id", None), parameters=fields))
            except CallError as error:
                refused.append(str(error))
    if as_json:
        print_json(records if Path(what).suffix else records[0] if records else None)
    else:
        for record in records:
            say(line_of(record))
    for text in refused:
        sys.stderr.write(f"robrain: {text}\n")
    if refused:
        raise typer.Exit(EXIT_REFUSED)


def _dry_run(tasks: "list[TaskWords]", connect: str | None, team: str, *, as_json: bool) -> None:
    """Print what would follow from each task if it came now, without those before it in the file."""
    from robrain.deploy.tasks.dry_run_words import dry_run_lines

    with connect_team(connect, team) as client:
        found = [client.dry_run(kind, id=fields.pop("id", None), parameters=fields) for kind, fields in tasks]
    for one in found:
        if as_json:
            print_json(one)
            continue
        for line in dry_run_lines(one):
            say(line)
    if any(one.refused for one in found):
        raise typer.Exit(EXIT_REFUSED)


def asked_tasks(
    what: str,
    *,
    at: str | None = None,
    task_id: str | None = None,
    priority: float | None = None,
    deadline: float | None = None,
    earliest: float | None = None,
    service: float | None = None,
    needs: list[str] | None = None,
    after: list[str] | None = None,
    robots: int | None = None,
    mote: str | None = None,
    robot: str | None = None,
    duration: float | None = None,
    interval: float | None = None,
    quantity: str | None = None,
    look_at: str | None = None,
    until_soc: float | None = None,
    parameters: list[str] | None = None,
) -> "list[TaskWords]":
    """The tasks that the options of `task add` ask for.

    Raises:
        UsageError, BadTask: naming the option, or file and key.

    """
    from robrain.client.submission import submission_of
    from robrain.deploy.errors import UsageError
    from robrain.deploy.tasks.task_files import TaskWords, parameters_set, point, tasks_in

    fields: dict[str, Any] = {
        "place": point("--at", at) if at is not None else None,
        "id": task_id,
        "priority": priority,
        "deadline_in_s": deadline,
        "earliest_in_s": earliest,
        "service_s": service,
        "needs": needs or None,
        "after": after or None,
        "robots": robots,
        "mote": mote,
        "robot": robot,
        "duration_s": duration,
        "interval_s": interval,
        "quantity": quantity,
        "look_at": point("--look-at", look_at) if look_at is not None else None,
        "until_soc": until_soc,
    }
    given = {name: value for name, value in fields.items() if value is not None}
    given |= parameters_set(parameters or [], given)
    if Path(what).suffix in (".toml", ".json"):
        if given:
            raise UsageError(f"{what}: a file has all fields of its tasks; leave the options out")
        return tasks_in(Path(what))
    submission_of(what, {"id": what, **given}, typed=OPTIONS)  # report mistakes before the team is contacted
    return [TaskWords(what, given)]
