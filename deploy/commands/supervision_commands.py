"""`robrain up`, `hub`, `top` and `doctor`. Each reads its options and calls the code that does the work."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, SET_UP, START, CommandApp
from robrain.deploy.command_line.options import (
    ConnectOption,
    IdleOption,
    JournalOption,
    JsonOption,
    KnownOption,
    ListenOption,
    MapOption,
    MotesOption,
    PortOption,
    RecordOption,
    RobotsOption,
    RulesOption,
    SeedOption,
    TeamOption,
    TimeLimitOption,
    UntilOption,
    above_zero,
    until_explored,
)
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM, check_name

EXIT_WRONG = 1
"""Exit status of `up` if a part was given up, and of `doctor` if something is wrong."""
EXIT_INTERRUPTED = 130

up_app = CommandApp(START)
supervision_app = CommandApp(OPERATE)

TeamArgument = Annotated[
    str | None, typer.Argument(help="A built-in name (depot), a scenario .toml file, or a team .toml file.")
]
HostOption = Annotated[str | None, typer.Option(help="Of a team file: start the parts of this machine.")]


@up_app.command()
def up(
    scenario: TeamArgument = None,
    host: HostOption = None,
    map_file: MapOption = None,
    known: KnownOption = False,
    robots: RobotsOption = None,
    motes: MotesOption = None,
    seed: SeedOption = None,
    idle: IdleOption = False,
    until: UntilOption = None,
    time_limit: TimeLimitOption = None,
    record: RecordOption = None,
    dashboard: Annotated[bool, typer.Option(help="Show the team in a browser page on 127.0.0.1.")] = True,
    port: PortOption = None,
    listen: Annotated[
        str | None,
        typer.Option(help="Endpoint of the team's hub; default: where commands on this machine look for a team."),
    ] = None,
    journal: JournalOption = None,
    stand_by: Annotated[
        bool, typer.Option("--stand-by", help="Also start a coordinator that stands by and takes over.")
    ] = False,
    rules: RulesOption = None,
    secured: Annotated[
        bool, typer.Option("--secured", help="Each part shows a certificate, made for this run; see --pki.")
    ] = False,
    pki: Annotated[
        Path | None, typer.Option(help="Secured, with the certificates of this folder of `robrain pki`.")
    ] = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object per line: hub, dashboard, forwarders, failures, result."),
    ] = False,
) -> None:
    """Start a team as separate processes in real time, and restart processes that end or hang.

    Exit status 1 if a part failed too often and was given up.
    """
    from robrain.deploy.supervision.part import ARENA, COORDINATOR, DASHBOARD, HUB, RECORDER, STAND_BY
    from robrain.deploy.supervision.team_file import is_team_file
    from robrain.deploy.supervision.up import UpPlan, new_journal, plan_of_host, up_command, witnesses_among

    target, limit_s = until_explored(until), above_zero("--time-limit", time_limit)
    if scenario is not None and is_team_file(Path(scenario)):
        given = {
            "--map": map_file, "--known": known or None, "--robots": robots, "--motes": motes, "--seed": seed,
            "--idle": idle or None, "--record": record, "--port": port,
            "--listen": listen, "--journal": journal, "--stand-by": stand_by or None, "--rules": rules,
            "--no-dashboard": None if dashboard else True, "--secured": secured or None, "--pki": pki,
            "--team": None if team == DEFAULT_TEAM else team,
        }  # fmt: skip
        if wrong := [option for option, value in given.items() if value is not None]:
            raise UsageError(f"{', '.join(wrong)}: not allowed here, because the team file {scenario} sets this")
        plan = plan_of_host(Path(scenario), host)
    else:
        from robrain.deploy.command_line.options import new_recording
        from robrain.deploy.command_line.scenario_choice import choose_scenario

        if host is not None:
            raise UsageError(f"--host {host}: expected a team file with [[hosts]]")
        check_name("team", team)
        chosen = choose_scenario(scenario, map_file, robots, motes, seed, known=known, idle=idle)
        if rules is not None:
            from robrain.deploy.processes.table_files import read_rules

            tables = read_rules(rules)
            chosen = chosen.replace(rules=tables.rules, missions=tables.missions)
        new_recording(record)
        world = chosen.world()
        names = [robot.name for robot in world.robots]
        place = world.first_place() if chosen.starts_known else None
        task = "" if place is None or as_json else f"robrain task add visit --at {place.x_m:g},{place.y_m:g}"
        optional = {DASHBOARD: dashboard, STAND_BY: stand_by, RECORDER: record is not None}
        plan = UpPlan(
            name=chosen.name,
            team=team,
            parts=[HUB, ARENA, COORDINATOR, *names, *(part for part, is_wanted in optional.items() if is_wanted)],
            scenario=chosen,
            words=_scenario_arguments(scenario, None if scenario else map_file, robots, motes, seed),
            listen=listen,
            robots=names,
            witnesses=witnesses_among(names) if stand_by else [],
            journal=journal or new_journal(team),
            record=record,
            dashboard_port=port,
            is_secured=secured or pki is not None,
            pki=pki,
            first_task=task,
        )
    result = up_command(plan._replace(until_explored=target, time_limit_s=limit_s), as_json=as_json)
    if result.given_up:
        raise typer.Exit(EXIT_WRONG)
    if result.ended == "interrupted" and (until, time_limit) != (None, None):
        raise typer.Exit(EXIT_INTERRUPTED)


@supervision_app.command(rich_help_panel=START)
def hub(listen: ListenOption = None) -> None:
    """Route a team's messages: the Zenoh router to which all others connect."""
    from robrain.deploy.processes.live_process import hub_command

    hub_command(listen)


@supervision_app.command()
def top(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    once: Annotated[bool, typer.Option("--once", help="Print the table once, after two seconds.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the processes of a running team: CPU, memory, message rates, as far as they are known."""
    from robrain.deploy.supervision.top import top_command

    top_command(connect, check_name("team", team), once=once, as_json=as_json)


@supervision_app.command(rich_help_panel=SET_UP)
def doctor(
    file: Annotated[
        Path | None, typer.Argument(help="A ROBOT.toml or a team file; default: this machine's hub.")
    ] = None,
    host: Annotated[str | None, typer.Option(help="Of a team file: check the parts of this machine.")] = None,
    connect: ConnectOption = None,
    team: Annotated[str | None, typer.Option(help="Name of the team; default: the one in the file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Report why a robot, or the parts of a machine, cannot join a team, and the remedy.

    Exit status 1 if something is wrong.
    """
    from robrain.deploy.machine.doctor import doctor_command

    if team is not None:
        check_name("team", team)
    if not doctor_command(file, host, connect, team, as_json=as_json):
        sys.stdout.flush()
        raise typer.Exit(EXIT_WRONG)


def _scenario_arguments(
    scenario: str | None, map_file: Path | None, robots: int | None, motes: int | None, seed: int | None
) -> list[str]:
    words = [scenario] if scenario is not None else []
    for option, value in (("--map", map_file), ("--robots", robots), ("--motes", motes), ("--seed", seed)):
        if value is not None:
            words += [option, str(value)]
    return words
