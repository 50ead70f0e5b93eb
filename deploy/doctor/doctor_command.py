"""`robrain doctor`: prints what was found."""

from pathlib import Path

from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.doctor.check import Check, is_good
from robrain.deploy.doctor.examination import examine_host, examine_hub, examine_robot
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import print_json_line
from robrain.deploy.supervision.team_file import is_team_file

MARKS = {True: "ok", False: "WRONG", None: "unknown"}


def doctor_command(
    file: Path | None, host: str | None, connect: str | None, team: str | None, *, as_json: bool
) -> bool:
    """Look, and print what was found; whether nothing is wrong.

    Args:
        file: a ROBOT.toml or a team file; None looks at a hub alone.
        host: of a team file: which machine.
        connect: endpoint of the team; not with a team file.
        team: its name; not with a team file.
        as_json: print an array of checks.

    Raises:
        UsageError: the options do not fit the file.

    """
    if file is not None and is_team_file(file):
        if connect is not None or team is not None:
            raise UsageError(f"--connect, --team: the team file {file} says that, not the command line")
        checks = examine_host(file, host)
    elif host is not None:
        raise UsageError(f"--host {host}: expected a team file with [[hosts]]")
    else:
        checks = examine_robot(file, connect, team) if file is not None else examine_hub(connect, team)
    if as_json:
        print_json_line(checks)
    else:
        for line in lines_of(checks):
            print_line(line)
    return is_good(checks)


def lines_of(checks: list[Check]) -> list[str]:
    """What was found, in words; what is wrong has its remedy in a line of its own."""
    lines = []
    for check in checks:
        lines.append(f"{MARKS[check.ok]:<8}{check.name.value}: {check.sentence}")
        if check.remedy:
            lines.append(f"{'':<8}  {check.remedy}")
    return lines
