"""What is looked at, in which order, for a robot's file, a machine of a team file, or a hub alone."""

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import NamedTuple

from robrain.agent.host.robot_file import TlsTable, folder_of
from robrain.deploy.commands.status_command import status_by
from robrain.deploy.doctor.certificate_checks import OwnCertificate, check_certificates
from robrain.deploy.doctor.check import Check, CheckName, is_good
from robrain.deploy.doctor.network_checks import check_address, check_port, check_router
from robrain.deploy.doctor.robot_checks import (
    check_can,
    check_devices,
    check_extras,
    check_grid,
    check_robot_file,
    check_robot_ports,
    own_version,
)
from robrain.deploy.doctor.team_checks import (
    check_clock,
    check_key_space,
    check_name_free,
    check_robots,
    check_versions,
    heard_skews_s,
    holders,
    members,
)
from robrain.deploy.errors import UsageError
from robrain.deploy.pki.errors import PkiError
from robrain.deploy.processes.live_process import live_endpoint
from robrain.deploy.supervision.credentials import OPERATOR, Credentials
from robrain.deploy.supervision.part import ARENA, HUB
from robrain.deploy.supervision.team_file import HostTable, TeamFile, read_team_file
from robrain.protocol.extras import missing_package
from robrain.protocol.wire.access.identity import TLS_VARIABLE, tls_folder
from robrain.protocol.wire.access.member import Member, MemberRole
from robrain.protocol.wire.errors import RobrainError
from robrain.protocol.wire.hub import given_endpoints, team_endpoints
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.protocol.wire.session import is_secured, open_session

PROBE = "doctor"
"""Name of a robot whose keys are tried where no robot is named."""


class JoinRequest(NamedTuple):
    """Who wants to join what."""

    endpoints: Sequence[str]
    team: str
    robots: Sequence[str]
    """Names whose keys and claims are looked at."""
    certificates: Sequence[OwnCertificate] = ()
    """What is to be shown at endpoints that ask for certificates."""


def examine_hub(connect: str | None, team: str | None) -> list[Check]:
    """The hub of this machine, or the one given."""
    shown = [OwnCertificate(None, tls_folder())]
    return examine_team(JoinRequest(team_endpoints(connect), team or DEFAULT_TEAM, [], shown))


def examine_robot(path: Path, connect: str | None, team: str | None) -> list[Check]:
    """A robot, by its file; the certificate that it names is shown by this process too from then on.

    Args:
        path: its ROBOT.toml.
        connect: endpoint; None takes the file's, or else this machine's hub.
        team: None takes the file's.

    """
    found, said = check_robot_file(path)
    if found is None:
        return [said]
    table, settings = found.robot_file.robot, found.robot_file.zenoh
    here = [said, check_extras(found), *check_can(found), check_grid(found), *check_robot_ports(found)]
    where = given_endpoints(connect) or settings.connect
    if not where and settings.listen:  # the robot is its own router
        return [*here, *check_devices(found, path.parent)] if is_good(here) else here
    if isinstance(settings.tls, TlsTable):
        os.environ[TLS_VARIABLE] = str(folder_of(path.parent, settings.tls.folder).resolve())
    name = team or table.team
    shown = [OwnCertificate(Member(MemberRole.ROBOT, name, table.name), tls_folder())]
    where = where or team_endpoints(None)
    team_checks = examine_team(JoinRequest(where, name, [table.name], shown))
    if _is_running(where, name, table.name):
        devices = [Check(CheckName.DEVICE, None, f"the devices are not opened: {table.name} runs and has them open")]
    else:
        devices = check_devices(found, path.parent)
    return [*here, *devices, *team_checks]


def _is_running(endpoints: Sequence[str], team: str, robot: str) -> bool:
    try:
        with closing(open_session(connect=endpoints)) as session:
            return bool(holders(session, team, robot))
    except RobrainError:  # the checks of the team report it
        return False


def examine_host(path: Path, host_name: str | None) -> list[Check]:
    """The parts of one machine, by the team file."""
    try:
        team_file = read_team_file(path)
        host = team_file.host(path, host_name)
    except UsageError as error:
        return [Check(CheckName.FILE, False, str(error), "correct the file, or give --host")]
    checks = [Check(CheckName.FILE, True, f"{path} is a team file; host {host.name} has {', '.join(host.parts)}")]
    checks.append(check_address(host.name, host.address))
    if team_file.team.scenario:
        checks.append(_check_scenario(path, team_file, host))
    for name in host.robots:
        if name in team_file.robots:
            found, said = check_robot_file(path.parent / team_file.robots[name])
            checks.append(said)
            if found is not None:
                checks += [check_extras(found), *check_can(found), check_grid(found), *check_robot_ports(found)]
    shown, as_member = _certificates_of(path, team_file, host)
    with as_member:
        if HUB in host.parts:
            checks.append(check_port("the hub", team_file.endpoint))
            if not check_router([team_file.endpoint]).ok:  # not started yet: there is no team to look at
                return [*checks, *check_certificates(shown, [team_file.endpoint])]
        # As an operator one sees all of a secured team, and may not try its robots' keys.
        robots = [] if shown else host.robots
        return [*checks, *examine_team(JoinRequest([team_file.endpoint], team_file.team.name, robots, shown))]


def _certificates_of(
    path: Path, team_file: TeamFile, host: HostTable
) -> tuple[list[OwnCertificate], AbstractContextManager[None]]:
    """What the parts of a machine show, and the time for which this process shows the operator's certificate."""
    team = team_file.team
    if not team.pki:
        return [], nullcontext()
    try:
        credentials = Credentials(path.parent / team.pki, team.name)
        shown = [OwnCertificate(credentials.member(part), credentials.folder(part)) for part in host.parts]
        shown.append(OwnCertificate(Member(MemberRole.OPERATOR, team.name, OPERATOR), credentials.operator))
    except PkiError as error:
        raise UsageError(str(error)) from error
    return shown, credentials.as_operator()


def examine_team(joining: JoinRequest) -> list[Check]:
    """What can be looked at from a client of the team's router."""
    checks = check_certificates(joining.certificates, joining.endpoints)
    if not is_good(checks):
        return checks
    router = check_router(joining.endpoints)
    checks.append(router)
    if not router.ok:
        return checks
    names = joining.robots or ([] if any(map(is_secured, joining.endpoints)) else [PROBE])
    try:
        checks += [check_key_space(joining.endpoints, joining.team, robot) for robot in names]
        with closing(open_session(connect=joining.endpoints)) as session:
            with live_endpoint(session, joining.team) as wire:
                checks += check_robots(status_by(wire))
            checks.append(check_clock(heard_skews_s(session, joining.team)))
            checks.append(check_versions(own_version(), members(session, joining.team)))
            checks += [check_name_free(robot, holders(session, joining.team, robot)) for robot in joining.robots]
    except RobrainError as error:  # the router has gone meanwhile
        checks.append(Check(CheckName.ROUTER, False, str(error), "look at the router"))
    return checks


def _check_scenario(path: Path, team_file: TeamFile, host: HostTable) -> Check:
    """Whether the scenario, and the map that it names, can be loaded here: for the arena and the robots' files."""
    name = team_file.team.scenario
    try:
        from robrain.deploy.commands.options import choose_scenario

        where = str(path.parent / name) if name.endswith(".toml") or "/" in name else name
        known = [robot.name for robot in choose_scenario(where, None, None, None, None).world().robots]
    except ModuleNotFoundError as error:
        missing = missing_package(error)
        if missing is None:
            raise
        needed = f"'{missing.needed}'" if missing.extra else missing.package
        return Check(
            CheckName.EXTRA, False, f"the scenario {name} needs {missing.package}, which is not installed",
            f"pip install {needed}",
        )  # fmt: skip
    except RobrainError as error:
        return Check(CheckName.MAP, False, str(error), f"correct the scenario {name}, or copy its map here")
    unknown = [robot for robot in host.robots if robot not in known and robot not in team_file.robots]
    if unknown:
        return Check(
            CheckName.FILE,
            False,
            f"the scenario {name} has no robot {unknown[0]}; it has {', '.join(known)}",
            f"name one of these in the parts of host {host.name}, or give its file in [robots]",
        )
    what = "simulates it" if ARENA in host.parts else "knows it"
    return Check(CheckName.MAP, True, f"the scenario {name} and its map are there; host {host.name} {what}")
