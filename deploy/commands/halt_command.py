"""`robrain halt` and `robrain resume`, for a team or one robot. They need no coordinator."""

import os

from robrain.client.halting import HaltReport
from robrain.client.team import Team
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import tell
from robrain.protocol.model.tasks.halt_latch import OPERATOR
from robrain.protocol.wire.keys import check_name

EXIT_DISOBEYED = 1


def halt_command(
    connect: str | None, team: str, robot: str | None = None, by: str | None = None, reason: str = ""
) -> int:
    """Halt a team, or one robot, and print which robots have stopped and which have not.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        robot: halt only this one.
        by: who halts; the same name may resume. Default is `operator:USER`.
        reason: for the logs; truncated, as a halt message must be small.

    Returns:
        The exit status: 1 if a robot has not confirmed in time that it stopped.

    Raises:
        RobrainError: nobody is there, or a name or endpoint is invalid.

    """
    _check_robot(robot)
    with Team.connect(connect, team=team) as client:
        return _print_report(client.halt(robot, reason=reason, by=_who(by)), None if robot else team)


def resume_command(connect: str | None, team: str, robot: str | None = None, by: str | None = None) -> int:
    """End a halt of a team, or of one robot; see `halt_command`. Prints robots that stay halted, with the reason."""
    _check_robot(robot)
    with Team.connect(connect, team=team) as client:
        return _print_report(client.resume(robot, by=_who(by)), None if robot else team)


def one_robot(argument: str | None, option: str | None) -> str | None:
    """The robot of a command that takes it as ROBOT and as --robot (UsageError if they name two)."""
    if argument is not None and option is not None and argument != option:
        raise UsageError(f"--robot {option}: expected one robot, got {argument} as well")
    return argument if argument is not None else option


def _check_robot(robot: str | None) -> None:
    if robot is not None:
        check_name("robot", robot)


def _print_report(report: HaltReport, team: str | None) -> int:
    done = "halted" if report.halted else "resumed"
    lines = dict.fromkeys(report.confirmed, done)
    lines |= {name: f"NOT {done}: {why}" for name, why in report.unconfirmed.items()}
    for name, text in sorted(lines.items()):
        tell(f"{name}: {text}")
    if team is not None:
        tell(f"team {team}: {len(report.confirmed)} of {len(lines)} robots {done}")
    return EXIT_DISOBEYED if report.unconfirmed else 0


def _who(by: str | None) -> str:
    return by if by is not None else f"{OPERATOR}:{os.environ.get('USER') or 'unknown'}"
