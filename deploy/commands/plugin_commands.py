"""`robrain plugin`: list, load, unload and reload the plugins of a running robot; write and check new ones."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam
from robrain.deploy.command_line.options import JsonOption, RobotArgument
from robrain.deploy.command_line.output import print_either, print_result
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import check_name

if TYPE_CHECKING:
    from robrain.client.team import Team
    from robrain.protocol.messages.robots.plugin_messages import PluginInfo

EXIT_MISTAKES = 1

plugin_app = CommandApp(
    OPERATE, "plugin", "List, load, unload and reload the plugins of a robot; write and check new ones."
)

PluginArgument = Annotated[str, typer.Argument(help="Name of the plugin.")]


@plugin_app.team_command("list")
def list_plugins(connect: ConnectTeam, robot: RobotArgument, as_json: JsonOption = False) -> None:
    """List a robot's plugins with state and reason."""
    infos = _team(connect, robot).plugins(robot)
    print_either(infos, lambda: _show(infos), as_json=as_json)


@plugin_app.team_command()
def load(
    connect: ConnectTeam,
    robot: RobotArgument,
    plugin: Annotated[
        str, typer.Argument(help="A name in the robot's plugin folders, or the path of a folder or manifest.")
    ],
) -> None:
    """Load a plugin, and those that it requires, into a running robot."""
    wanted = _name_or_path(plugin)
    _print_states(_team(connect, robot).load(robot, wanted))


@plugin_app.team_command()
def unload(
    connect: ConnectTeam,
    robot: RobotArgument,
    plugin: PluginArgument,
    cascade: Annotated[bool, typer.Option("--cascade", help="Also unload the plugins that require it.")] = False,
) -> None:
    """Unload a plugin; refused while others require it."""
    check_name("plugin", plugin)
    _print_states(_team(connect, robot).unload(robot, plugin, cascade=cascade))


@plugin_app.team_command()
def reload(connect: ConnectTeam, robot: RobotArgument, plugin: PluginArgument) -> None:
    """Load a plugin again after an edit; if that fails, the old one keeps running."""
    check_name("plugin", plugin)
    _print_states(_team(connect, robot).reload(robot, plugin))


@plugin_app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the plugin, a valid Python identifier.")],
    level: Annotated[str, typer.Option(help="device, unit, skill or behavior.")],
    active: Annotated[bool, typer.Option("--active", help="Active: with a period and a step.")] = False,
    hidden: Annotated[bool, typer.Option("--hidden", help="Not callable from outside the robot.")] = False,
    folder: Annotated[Path, typer.Option("--dir", help="Folder in which the plugin's own folder is created.")] = Path(),
) -> None:
    """Write the skeleton of a plugin: class, manifest and a test that passes."""
    from robrain.agent.authoring.skeleton import write_skeleton

    for path in write_skeleton(name, level, folder, active=active, hidden=hidden):
        print_result(str(path))


@plugin_app.command()
def check(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder with plugins.")]) -> None:
    """Find mistakes in a folder of plugins without a robot; exit status 1 if there are any."""
    from robrain.agent.authoring.plugin_check import check_plugins
    from robrain.agent.manifest import find_manifests

    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; expected one with plugins")
    findings = check_plugins(folder)
    for finding in findings:
        print_result(str(finding))
    mistakes = sum(not finding.is_warning for finding in findings)
    words = [_count(len(find_manifests(folder)), "plugin"), _count(mistakes, "mistake")]
    if len(findings) > mistakes:
        words.append(_count(len(findings) - mistakes, "warning"))
    print_result(", ".join(words))
    if mistakes:
        raise typer.Exit(EXIT_MISTAKES)


def _team(connect: ConnectTeam, robot: str) -> "Team":
    check_name("robot", robot)
    return connect()


def _name_or_path(text: str) -> str:
    """Make a path of this machine absolute; return a name, or a path of the robot's machine, unchanged."""
    path = Path(text)
    if path.exists():
        return str(path.resolve())
    if path.is_absolute():
        return text
    if len(path.parts) > 1 or path.suffix == ".toml":
        raise UsageError(f"{text}: no such folder or manifest here; a path on the robot's machine must begin with /")
    return check_name("plugin", text)


def _show(infos: "list[PluginInfo]") -> None:
    from robrain.deploy.command_line.terminal import new_table, results
    from robrain.protocol.safe_text import safe_lines

    headings = ("plugin", "level", "state", "visible to", "holder", "functions", "distribution", "why")
    rows = [
        (
            info.name,
            info.level,
            info.state,
            ", ".join(info.visibility),
            info.holder,
            str(len(info.functions)),
            info.distribution,
            info.reason,
        )
        for info in infos
    ]
    given = [index for index in range(len(headings)) if any(row[index] for row in rows)]  # no empty columns
    table = new_table(*(headings[index] for index in given), right=["functions"])
    for row in rows:
        table.add_row(*(safe_lines(row[index]) for index in given))
    results().print(table)
    for info in infos:
        if info.detail:
            print_result("")
            print_result(f"{info.name}: {info.where}\n{info.detail}")


def _print_states(infos: "list[PluginInfo]") -> None:
    for info in infos:
        where = f" ({info.where})" if info.where else ""
        print_result(f"{info.name}: {info.state}{f': {info.why}{where}' if info.why else ''}")


def _count(number: int, what: str) -> str:
    return f"{number or 'no'} {what}{'s' if number != 1 else ''}"
