"""Commands to a running team and its robots: halts, calls, and the state of the team."""

import sys
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam
from robrain.deploy.command_line.options import ConnectOption, JsonOption, RobotArgument, TeamOption, WireFormat
from robrain.deploy.command_line.output import print_either, print_result
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM, check_name

if TYPE_CHECKING:
    from robrain.client.halting import HaltReport
    from robrain.sim.scenarios.scenario import ListedScenario


EXIT_DISOBEYED = 1
"""Exit status of `halt` and `resume` if a robot has not confirmed in time."""

team_app = CommandApp(OPERATE)

RobotOption = Annotated[str | None, typer.Option(help="The same as ROBOT.")]
OneRobotArgument = Annotated[
    str | None, typer.Argument(metavar="ROBOT", help="This robot only; default: the whole team.")
]
ByOption = Annotated[str | None, typer.Option(help="Name of the person or program that asks; default: operator:$USER.")]


@team_app.team_command()
def halt(
    connect: ConnectTeam,
    one: OneRobotArgument = None,
    robot: RobotOption = None,
    by: ByOption = None,
    reason: Annotated[str, typer.Option(help="Reason, for the log.")] = "",
) -> None:
    """Emergency halt: stop all robots, and list the robots that have not stopped."""
    name = one_robot(one, robot)
    team = connect()
    _end(team.halt(name, reason=reason, by=by), None if name else team.transport.team)


@team_app.team_command()
def lead(connect: ConnectTeam) -> None:
    """Have the coordinator lead, by your word: no other journal has more, and silent robots do no tasks."""
    if skipped := connect().lead():
        print_result(f"silent robots that do not count until they are heard again: {', '.join(skipped)}")
    else:
        print_result("all robots count: none of them is silent, or the coordinator leads already")


@team_app.team_command()
def remove(connect: ConnectTeam, robot: RobotArgument) -> None:
    """Remove a robot that has gone: status and page show it as gone until then."""
    check_name("robot", robot)
    connect().remove_robot(robot)
    print_result(f"{robot}: removed")


@team_app.team_command()
def resume(connect: ConnectTeam, one: OneRobotArgument = None, robot: RobotOption = None, by: ByOption = None) -> None:
    """End an emergency halt; allowed to the one that halted, and to operators."""
    name = one_robot(one, robot)
    team = connect()
    _end(team.resume(name, by=by), None if name else team.transport.team)


@team_app.team_command()
def shell(connect: ConnectTeam, robot: RobotArgument) -> None:
    """Call a robot's plugins interactively: call driver stop(), list, help driver."""
    from robrain.deploy.commands.shell import run_shell

    check_name("robot", robot)
    if failed := run_shell(connect(), robot, interactive=sys.stdin.isatty()):
        raise typer.Exit(failed)


@team_app.command(context_settings={"ignore_unknown_options": True})  # negative numbers are arguments
def call(
    robot: RobotArgument,
    plugin: Annotated[str, typer.Argument(help="Name of the plugin.")],
    function: Annotated[str, typer.Argument(help="Name of the function; without it the functions are listed.")] = "",
    arguments: Annotated[
        list[str] | None, typer.Argument(help="Arguments as VALUE or NAME=VALUE, or one JSON array or object.")
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Call a function of a robot's plugin, and print its result: call r1 localisation pose, call r1 driver drive 1.

    For a long action, such as that of drive, it prints the action's id and waits for its end. Exit status 1 if the
    action is not done, for example because `explore` has superseded it.
    """
    from robrain.deploy.commands.call_command import call_command

    if failed := call_command(connect, team, robot, plugin, function, arguments or [], as_json=as_json):
        raise typer.Exit(failed)


@team_app.team_command()
def log(
    connect: ConnectTeam,
    robot: RobotArgument,
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Print further lines as they come.")] = False,
    plugin: Annotated[str, typer.Option(help="Only the lines of this plugin.")] = "",
) -> None:
    """Print the output and logs of a robot's plugins, and its faults and halts."""
    from datetime import datetime

    check_name("robot", robot)
    team = connect()
    if plugin and plugin not in (names := [info.name for info in team.plugins(robot)]):
        raise UsageError(f"{robot} has no plugin {plugin}; there are: {', '.join(names)}")
    for record in team.log(robot, follow=follow):
        if plugin in ("", record.source):
            level = "" if record.level == "info" else f" {record.level}"
            time = datetime.fromtimestamp(record.stamp_ns / 1e9).astimezone()
            print_result(f"{time:%H:%M:%S} {record.source}{level}: {record.text}")


@team_app.command()
def status(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """Show each robot of a team in one line: state, battery, place, task, and plugins that do not run."""
    from robrain.deploy.supervision.team_status import show_status, status_of

    found = status_of(connect, check_name("team", team))
    print_either(found, lambda: show_status(found), as_json=as_json)


def one_robot(argument: str | None, option: str | None) -> str | None:
    """The robot of a command that has it as ROBOT and as --robot (UsageError if they name two)."""
    if argument is not None and option is not None and argument != option:
        raise UsageError(f"--robot {option}: expected one robot, got {argument} as well")
    name = argument if argument is not None else option
    return name if name is None else check_name("robot", name)


def _end(report: "HaltReport", team: str | None) -> None:
    """Print which robots have obeyed and which have not, and end the command."""
    done = "halted" if report.halted else "resumed"
    lines = dict.fromkeys(report.confirmed, done)
    lines |= {name: f"NOT {done}: {reason}" for name, reason in report.unconfirmed.items()}
    for name, text in sorted(lines.items()):
        print_result(f"{name}: {text}")
    if team is not None:
        print_result(f"team {team}: {len(report.confirmed)} of {len(lines)} robots {done}")
    if report.unconfirmed:
        raise typer.Exit(EXIT_DISOBEYED)


def scenarios(as_json: JsonOption = False) -> None:
    """List the scenarios that come with robrain; `robrain run NAME` runs one."""
    from robrain.sim.scenarios.scenario import listed_scenarios

    found = listed_scenarios()
    print_either({"scenarios": found}, lambda: _show(found), as_json=as_json)


def _show(found: "list[ListedScenario]") -> None:
    from robrain.deploy.command_line.terminal import new_table, results

    table = new_table("name", "floor", "robots", "motes", "about", right=("floor", "robots", "motes"))
    for one in found:
        size = f"{one.width_m:g} × {one.height_m:g} m"
        table.add_row(one.name, size, str(one.robots), str(one.motes), one.about)
    results().print(table)


def wire_text(wire_format: WireFormat) -> str:
    """Describe the wire in the given format, with a newline at the end."""
    from robrain.protocol.schema.document import wire_document
    from robrain.protocol.schema.page import wire_page

    if wire_format is WireFormat.MARKDOWN:
        return wire_page()
    return msgspec.json.format(msgspec.json.encode(wire_document()), indent=2).decode() + "\n"
