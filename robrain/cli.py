"""The command line: commands of robrain's core; all others register themselves as entry points."""

import errno
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.command_group import (
    CONNECT,
    RECORDINGS,
    SIMULATE,
    START,
    CommandGroup,
    add_registered,
    missing_extra,
)
from robrain.deploy.command_line.options import (
    ConnectOption,
    IdleOption,
    JournalOption,
    JsonOption,
    KnownOption,
    ListenOption,
    MapOption,
    MotesOption,
    NearOption,
    PortOption,
    RecordOption,
    RobotsOption,
    RulesOption,
    ScenarioArgument,
    SeedOption,
    TeamOption,
    TimeLimitOption,
    UntilOption,
    WireFormat,
    WitnessesOption,
)
from robrain.deploy.command_line.output import print_json
from robrain.deploy.commands.team_commands import scenarios
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.agent_arguments import agent_arguments
from robrain.deploy.processes.process_setup import guarded_streams, limit_native_threads, set_up_logs
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.errors import CallError, RobrainError
from robrain.protocol.keys import DEFAULT_REPLAY_TEAM, DEFAULT_TEAM, check_name
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.safe_text import safe_lines

if TYPE_CHECKING:
    from robrain.sim.lockstep.result import RunResult
    from robrain.sim.scenarios.scenario import Scenario

DEMO = "depot"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
EXTRAS = {
    **dict.fromkeys(("run", "demo", "arena", "scenarios"), "sim"),
    **dict.fromkeys(("dashboard", "replay"), "team"),
}
"""Extra with all that a command of this file needs."""

app = typer.Typer(
    name="robrain",
    cls=CommandGroup,
    help="Coordinate teams of mobile robots and sensor motes over Zenoh.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"robrain {version('robrain')}\n")
        raise typer.Exit


@app.callback()
def options(
    print_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    tls: Annotated[
        Path | None,
        typer.Option(help="Folder of your certificate, to connect to tls/HOST:PORT; default: $ROBRAIN_TLS."),
    ] = None,
) -> None:
    """Coordinate teams of mobile robots and sensor motes over Zenoh."""
    if tls is not None:  # for the processes that a command starts as well
        os.environ[TLS_VARIABLE] = str(tls.expanduser().resolve())


@app.command(rich_help_panel=SIMULATE)
def run(
    scenario: ScenarioArgument = None,
    map_file: MapOption = None,
    known: KnownOption = False,
    robots: RobotsOption = None,
    motes: MotesOption = None,
    seed: SeedOption = None,
    near: NearOption = None,
    idle: IdleOption = False,
    strategy: Annotated[
        str | None, typer.Option(help="Exploration strategy: a name such as joint, or FILE.py:NAME.")
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="Allocator of tasks: a name such as auction, or FILE.py:NAME.")
    ] = None,
    fidelity: Annotated[
        str | None, typer.Option(help="Fidelity: full, or points, where robots are points and runs are fast.")
    ] = None,
    until: UntilOption = None,
    time_limit: TimeLimitOption = None,
    speed: Annotated[
        float | None,
        typer.Option(help="Factor of real time; 0 is as fast as possible. Default: 0, with the dashboard 5."),
    ] = None,
    record: RecordOption = None,
    dashboard: Annotated[bool, typer.Option(help="Show the run in a browser page on 127.0.0.1.")] = False,
    port: PortOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario in lockstep: repeatable, and as fast as possible."""
    from robrain.deploy.command_line.options import new_recording
    from robrain.deploy.processes.run_options import RunOptions
    from robrain.deploy.processes.starting import start_run

    def choose() -> "Scenario":
        from robrain.deploy.command_line.scenario_choice import choose_scenario

        chosen = choose_scenario(
            scenario, map_file, robots, motes, seed, near, known=known, idle=idle, strategy=strategy, method=method
        )
        return chosen if fidelity is None else chosen.replace(fidelity=fidelity)

    options = RunOptions(
        until=until,
        time_limit_s=time_limit,
        speed=speed,
        record=new_recording(record),
        dashboard=dashboard,
        port=port,
        quiet=as_json,
    )
    _finish(start_run(choose, options), as_json=as_json)


@app.command(rich_help_panel=SIMULATE)
def demo(
    headless: Annotated[bool, typer.Option(help="Without the dashboard, for servers.")] = False,
    speed: Annotated[
        float | None, typer.Option(help="Factor of real time; 0 is as fast as possible. Default: 1, headless 0.")
    ] = None,
    seed: SeedOption = None,
    port: PortOption = None,
) -> None:
    """Let a team explore the built-in depot for a minute, shown in the browser and recorded in runs/."""
    from robrain.deploy.command_line.options import next_file
    from robrain.deploy.processes.run_options import RunOptions
    from robrain.deploy.processes.starting import start_run

    def choose() -> "Scenario":
        from robrain.deploy.command_line.scenario_choice import choose_scenario

        return choose_scenario(DEMO, None, None, None, seed)

    options = RunOptions(
        speed=speed if speed is not None else 0.0 if headless else 1.0,
        record=next_file(Path("runs"), DEMO),
        dashboard=not headless,
        port=port,
        stay=sys.stdin.isatty(),
    )
    _finish(start_run(choose, options), as_json=False)


@app.command(rich_help_panel=START)
def arena(
    scenario: ScenarioArgument = None,
    map_file: MapOption = None,
    robots: RobotsOption = None,
    motes: MotesOption = None,
    seed: SeedOption = None,
    connect: ConnectOption = None,
    listen: ListenOption = None,
    team: TeamOption = DEFAULT_TEAM,
    robot_files: Annotated[
        Path | None, typer.Option(help="Write a ROBOT.toml for each robot into this folder.")
    ] = None,
    resume: Annotated[Path | None, typer.Option(hidden=True, help="Written by `robrain up`.")] = None,
) -> None:
    """Simulate a scenario's robots and motes in real time; agents drive them over the wire."""
    from robrain.deploy.command_line.scenario_choice import choose_scenario
    from robrain.deploy.processes.arena_process import arena_command
    from robrain.deploy.processes.live_process import place_of

    chosen = choose_scenario(scenario, map_file, robots, motes, seed)
    arena_command(chosen, place_of(connect, listen), check_name("team", team), robot_files, resume)


@app.command(rich_help_panel=START)
def agent(
    robot: Annotated[Path, typer.Argument(help="The robot's ROBOT.toml.")],
    connect: ConnectOption = None,
    team: Annotated[str | None, typer.Option(help="Name of the team; default: the one in the file.")] = None,
    votes: Annotated[
        Path | None, typer.Option(help="Folder for the robot's votes; default: $STATE_DIRECTORY or ~/.local/state.")
    ] = None,
) -> None:
    """Run the agent of one robot: it hosts the robot's plugins."""
    _run_agent(robot, connect, team, votes)


@app.command(rich_help_panel=START)
def coordinator(
    connect: ConnectOption = None,
    listen: ListenOption = None,
    team: TeamOption = DEFAULT_TEAM,
    journal: JournalOption = None,
    objective: Annotated[
        Objective | None, typer.Option(help="Planning objective; default: that of the planning file, or energy.")
    ] = None,
    planning: Annotated[
        Path | None, typer.Option(help="TOML file with a [planning] table, such as a scenario.")
    ] = None,
    rules: RulesOption = None,
    floor: Annotated[
        Path | None,
        typer.Option(help="Known floor, which the team does not explore: a map.yaml, or the recording of a run."),
    ] = None,
    witnesses: WitnessesOption = None,
    stand_by: Annotated[bool, typer.Option("--stand-by", hidden=True)] = False,
) -> None:
    """Coordinate a team: merge its maps, assign its tasks, and continue from the journal."""
    from robrain.deploy.processes.coordinator_process import coordinator_command, read_witnesses
    from robrain.deploy.processes.live_process import place_of

    where, team = place_of(connect, listen), check_name("team", team)
    elect = read_witnesses(witnesses, is_candidate=stand_by)
    coordinator_command(where, team, journal, objective, planning, rules, elect, floor)


@app.command(rich_help_panel=START)
def dashboard(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    port: PortOption = None,
) -> None:
    """Show a team in a browser page on 127.0.0.1."""
    from robrain.deploy.recordings.replaying import dashboard_command

    dashboard_command(connect, check_name("team", team), port)


@app.command(rich_help_panel=RECORDINGS)
def replay(
    recording: Annotated[Path, typer.Argument(help="An MCAP file that robrain recorded.")],
    speed: Annotated[float, typer.Option(help="Factor of the recorded speed.")] = 1.0,
    start: Annotated[
        float | None,
        typer.Option(help="Begin this many seconds after the first message; default: a page shows the end."),
    ] = None,
    dashboard: Annotated[
        bool,
        typer.Option(help="Show it in a browser page on 127.0.0.1, or publish it on the wire for other programs."),
    ] = True,
    port: PortOption = None,
    loop: Annotated[bool, typer.Option("--loop", help="On the wire: start again at the end.")] = False,
    paused: Annotated[
        bool, typer.Option("--paused", help="On the wire: start paused; a key or a query continues.")
    ] = False,
    connect: ConnectOption = None,
    team: Annotated[
        str, typer.Option(help="On the wire: name of the team that publishes the messages.")
    ] = DEFAULT_REPLAY_TEAM,
) -> None:
    """Show a recording in a browser page, or publish it on the wire."""
    from robrain.deploy.recordings.replaying import check_replay, replay_on_wire, show_recording
    from robrain.protocol.wire.hub import given_endpoints

    for_the_wire = {
        "--loop": loop,
        "--paused": paused,
        "--connect": connect is not None,
        "--team": team != DEFAULT_REPLAY_TEAM,
    }
    check_replay(speed, start or 0.0, [option for option, given in for_the_wire.items() if given and dashboard])
    if dashboard:
        from robrain.lab.fork.fork_child import ForkChild

        show_recording(recording, ForkChild(recording), port, speed, math.inf if start is None else start)
        return
    where = given_endpoints(connect)
    replay_on_wire(recording, speed, loop=loop, connect=where, team=team, start_s=start or 0.0, paused=paused)


app.command(rich_help_panel=SIMULATE)(scenarios)


@app.command(rich_help_panel=CONNECT)
def metrics(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)] = 9464,
) -> None:
    """Serve a team's metrics for Prometheus on this machine, at /metrics."""
    from robrain.deploy.processes.metrics_process import metrics_command

    metrics_command(connect, check_name("team", team), port)


@app.command(rich_help_panel=CONNECT)
def wire(
    wire_format: Annotated[
        WireFormat, typer.Option("--format", help="jsonschema is for programs, markdown for people.")
    ] = WireFormat.MARKDOWN,
) -> None:
    """Print every topic, query and token, with the types, units and ranges of what they carry."""
    from robrain.deploy.commands.team_commands import wire_text

    sys.stdout.write(wire_text(wire_format))


@cache
def all_commands() -> typer.Typer:
    """The program with all its commands, those of entry points included."""
    registered = add_registered(app)
    if not registered:
        raise UsageError("the installed robrain has no commands: install it again, as with `pip install -e .`")
    EXTRAS.update(registered)
    return app


def main() -> None:
    """Entry point: prints an error as one sentence, with exit status 2."""
    limit_native_threads()
    with guarded_streams(), _said_in_words():
        sys.argv[1:] = set_up_logs(sys.argv[1:])
        words = agent_arguments(sys.argv[1:])
        if words is None:
            own = {command.callback.__name__ for command in app.registered_commands if command.callback}
            program = app if own.intersection(sys.argv[1:2]) else all_commands()  # entry points take 0.3 s to load
            program(prog_name="robrain")
        else:
            _run_agent(*words)


def _run_agent(robot: Path, connect: str | None, team: str | None, votes: Path | None) -> None:
    from robrain.deploy.processes.agent_process import agent_command

    agent_command(robot, connect, team, votes)


def _finish(result: "RunResult", *, as_json: bool) -> None:
    if as_json:
        print_json(result)
    if result.ended == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)


@contextmanager
def _said_in_words() -> Iterator[None]:
    try:
        yield
    except RobrainError as error:
        text = str(error)
        if isinstance(error, CallError) and error.detail not in text:
            text += f"\n{error.detail}"
        sys.stderr.write(f"robrain: {safe_lines(text, '  ')}\n")
        sys.exit(EXIT_BAD_INPUT)
    except ModuleNotFoundError as error:
        missing = missing_extra(error, sys.argv[1:], EXTRAS)
        if missing is None:
            raise
        sys.stderr.write(f"robrain: {missing}\n")
        sys.exit(EXIT_BAD_INPUT)
    except OSError as error:
        unwritable = (errno.ENOENT, errno.EACCES, errno.EROFS, errno.ENOSPC)
        tells_itself = type(error) is OSError and error.errno is None  # a library, which says what it needs
        if error.filename is None and error.errno not in unwritable and not tells_itself:
            raise
        what = error.filename or "a file, shared memory (/dev/shm) or the folder for temporary files (TMPDIR)"
        text = str(error) if tells_itself else f"{what} cannot be used: {error.strerror}"
        sys.stderr.write(f"robrain: {safe_lines(text, '  ')}\n")
        sys.exit(EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
