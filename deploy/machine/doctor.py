"""`robrain doctor`: checks of a robot, of the parts of a machine, and of their team."""

import errno
import logging
import os
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from robrain.agent.class_import import import_class
from robrain.agent.errors import ManifestError, PackageMissing, PluginMissing, RobotFileError
from robrain.agent.host.agent_host import AgentHost, stock_place
from robrain.agent.host.robot_file import RobotFile, TlsTable, folder_of, read_robot_file
from robrain.agent.lifecycle.plugin_folders import PluginFolders, entry_point_places
from robrain.agent.manifest import Manifest, read_manifest
from robrain.agent.plugin import Level
from robrain.deploy.command_line.output import print_json
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import PkiError, UsageError
from robrain.deploy.machine.team_checks import (
    Check,
    CheckName,
    check_clock,
    check_key_space,
    check_name_free,
    check_robot,
    check_versions,
    good,
    holders,
    members,
    stamp_skews_s,
    unknown,
    wrong,
)
from robrain.deploy.processes.live_process import live_endpoint
from robrain.deploy.supervision.credentials import OPERATOR, Credentials
from robrain.deploy.supervision.part import ARENA, HUB
from robrain.deploy.supervision.team_file import HostTable, TeamFile, is_team_file, read_team_file
from robrain.deploy.supervision.team_status import status_by
from robrain.protocol.access.identity import TLS_VARIABLE, read_identity, tls_folder
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import NobodyThere, PortInUse, RobrainError, WireError
from robrain.protocol.extras import missing_package
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.hub import given_endpoints, team_endpoints
from robrain.protocol.wire.session import check_port_free, is_secured, listening_at, may_answer, open_session

PROBE = "doctor"
"""Name of a robot whose keys are tried where no robot is named."""
SOCKETCAN = "socketcan"
NETWORK = Path("/sys/class/net")
IFF_UP = 1
"""Of an interface's flags, netdevice(7)."""
MAPPER = "mapper"
GRID = ("resolution_m", "origin_x_m", "origin_y_m", "width_m", "height_m")
MARKS = {True: "ok", False: "WRONG", None: "unknown"}


def is_good(checks: Sequence[Check]) -> bool:
    """Whether no check failed; an impossible check does not count as failed."""
    return all(check.ok is not False for check in checks)


def check_router(endpoints: Sequence[str]) -> Check:
    """Whether a Zenoh router answers at one of the endpoints."""
    where = ", ".join(endpoints)
    if not any(map(may_answer, endpoints)):
        return wrong(
            CheckName.ROUTER,
            f"nobody listens at {where}",
            "start `robrain up` or a Zenoh router there, and look at address, port and firewall; "
            "--connect or [zenoh] connect names another",
        )
    try:
        open_session(connect=endpoints).close()
    except (NobodyThere, WireError):
        return wrong(
            CheckName.ROUTER,
            f"something listens at {where}, but admits no client: it is no Zenoh router, or refuses the certificate",
            "look at what listens there, and at the certificates of both",
        )
    return good(CheckName.ROUTER, f"a router answers at {where}")


def check_port(what: str, endpoint: str) -> Check:
    """Whether a part can listen at an endpoint. A router that answers there is the part itself.

    Args:
        what: the part, for the sentence: `the hub`.
        endpoint: such as `tcp/127.0.0.1:7447`.

    """
    try:
        check_port_free(endpoint)
    except PortInUse:
        if check_router([endpoint]).ok:
            return good(CheckName.PORT, f"{what} is at {endpoint} already")
        return wrong(
            CheckName.PORT,
            f"{what} cannot listen at {endpoint}: the port is taken",
            "end the process that listens there (`ss -ltnp` names it), or choose another port",
        )
    except WireError as error:
        return wrong(CheckName.PORT, f"{what} cannot listen: {error}", "choose an address of this machine")
    return good(CheckName.PORT, f"{what} can listen at {endpoint}")


def check_address(host: str, address: str) -> Check:
    """Whether a host's address is one of this machine's, so that its parts are started on the right one."""
    try:
        infos = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)
    except OSError as error:
        return wrong(
            CheckName.ADDRESS,
            f"the address {address} of host {host} is unknown here: {error.strerror}",
            "give an IP address, or make the name known to this machine",
        )
    for family, kind, _, _, place in infos:
        with closing(socket.socket(family, kind)) as probe:
            try:
                probe.bind(place)
            except OSError as error:
                if error.errno != errno.EADDRNOTAVAIL:
                    return unknown(CheckName.ADDRESS, f"the address {address} cannot be tried: {error.strerror}")
            else:
                return good(CheckName.ADDRESS, f"this machine has the address {address} of host {host}")
    return wrong(
        CheckName.ADDRESS,
        f"this machine does not have the address {address} of host {host}",
        f"run this on the machine of host {host}, or correct its address in the team file",
    )


class RobotFound(NamedTuple):
    """Content of a robot's file."""

    robot_file: RobotFile
    manifests: list[Manifest]
    """Of the plugins that are loaded."""

    def parameters(self, manifest: Manifest) -> Mapping[str, Any]:
        """Parameters of a plugin: the robot's file has precedence."""
        return {**manifest.parameters, **self.robot_file.parameters.get(manifest.name, {})}


def check_robot_file(path: Path) -> tuple[RobotFound | None, Check]:
    """Whether a robot's file, and the manifests of its plugins, can be read."""
    try:
        robot_file = read_robot_file(path)
        manifests = _manifests(robot_file, path.parent)
    except (RobotFileError, ManifestError, PluginMissing) as error:
        return None, wrong(CheckName.FILE, str(error), "correct the file")
    name = robot_file.robot.name
    return RobotFound(robot_file, manifests), good(CheckName.FILE, f"{path} is a robot's file, of {name}")


def check_can(found: RobotFound, network: Path = NETWORK) -> list[Check]:
    """Whether the CAN interfaces of the robot's devices are there and up.

    Args:
        found: the robot.
        network: directory in which Linux lists network interfaces.

    """
    plugins: dict[str, list[str]] = {}
    for manifest in found.manifests:
        parameters = found.parameters(manifest)
        if parameters.get("interface") == SOCKETCAN:
            plugins.setdefault(str(parameters.get("channel", "can0")), []).append(manifest.name)
    return [_check_interface(channel, names, network) for channel, names in sorted(plugins.items())]


def check_extras(found: RobotFound, import_plugin: Callable[[Manifest], object] = import_class) -> Check:
    """Whether the packages are installed that the robot's plugins need.

    Args:
        found: the robot.
        import_plugin: imports a plugin's class.

    """
    lacking: dict[str, list[str]] = {}
    for manifest in found.manifests:
        try:
            import_plugin(manifest)
        except PackageMissing as error:
            lacking.setdefault(error.needed, []).append(manifest.name)
        except ManifestError as error:
            return wrong(CheckName.EXTRA, str(error), f"correct the plugin {manifest.name}")
    if not lacking:
        return good(CheckName.EXTRA, f"the {len(found.manifests)} plugins have the packages that they need")
    needs = "; ".join(f"{', '.join(names)} need {needed}" for needed, names in sorted(lacking.items()))
    installs = " ".join(f"'{needed}'" for needed in sorted(lacking))
    return wrong(CheckName.EXTRA, f"packages are missing: {needs}", f"pip install {installs}")


def check_devices(found: RobotFound, base: Path) -> list[Check]:
    """Whether each device opens the resources that its parameters name, as at the robot's start; all close at once.

    Args:
        found: the robot.
        base: folder of its file.

    """
    names = [manifest.name for manifest in found.manifests if _is_device(manifest)]
    if not names:
        return []
    table, checks = replace(found.robot_file.robot, load=names), list[Check]()
    logging.disable()  # the checks report the log's content
    try:
        with closing(open_session(mode="router", listen=["tcp/127.0.0.1:0"])) as session:
            zenoh = replace(found.robot_file.zenoh, connect=listening_at(session))
            robot_file = replace(found.robot_file, robot=table, zenoh=zenoh)
            host = AgentHost(robot_file, base, session, LiveClock(), Drive.LIVE)
            try:
                host.start()
                plugins = host.manager.plugins.values()
                faults = {each.name: each.state_reason for each in plugins if not each.state.is_running}
                needing = {each.name for each in plugins if each.needs}
            finally:
                host.close()
    finally:
        logging.disable(logging.NOTSET)
    for name, fault in faults.items():
        if name not in needing:
            remedy = f"correct [parameters.{name}], or connect the device and give this user the right to open it"
            checks.append(wrong(CheckName.DEVICE, f"{name} cannot start: {fault}", remedy))
    if opened := [name for name in names if name not in faults]:
        checks.append(good(CheckName.DEVICE, f"devices that open what their parameters name: {', '.join(opened)}"))
    return checks


def check_grid(found: RobotFound) -> Check:
    """Whether the robot's file has the team's grid of the map: patches on another grid are refused."""
    mapper = next((manifest for manifest in found.manifests if manifest.name == MAPPER), None)
    if mapper is None:
        return good(CheckName.MAP, "the robot makes no map")
    parameters = found.parameters(mapper)
    missing = [key for key in GRID if key not in found.robot_file.parameters.get(MAPPER, {})]
    size = f"{parameters['width_m']:g} × {parameters['height_m']:g} m"
    corner = f"({parameters['origin_x_m']:g}, {parameters['origin_y_m']:g})"
    if missing:
        return unknown(
            CheckName.MAP,
            f"the file does not say on which map the robot works, so it is {size} from {corner}",
            f"every robot of a team needs the same map: give {', '.join(missing)} in [parameters.mapper]",
        )
    return good(CheckName.MAP, f"the robot maps {size} from {corner}")


def check_robot_ports(found: RobotFound) -> list[Check]:
    """Whether the ports are free on which the robot and its `tcp_socket` listen."""
    listens = [(found.robot_file.robot.name, endpoint) for endpoint in found.robot_file.zenoh.listen]
    for manifest in found.manifests:
        parameters = found.parameters(manifest)
        if parameters.get("enabled") and parameters.get("port") and manifest.name == "tcp_socket":
            listens.append((manifest.name, f"tcp/{parameters.get('host', '127.0.0.1')}:{parameters['port']}"))
    return [check_port(what, endpoint) for what, endpoint in listens]


def _manifests(robot_file: RobotFile, base: Path) -> list[Manifest]:
    places = [stock_place(), *(place for place, _ in entry_point_places())]
    places += [folder_of(base, place) for place in robot_file.robot.places]
    found = PluginFolders(places, robot_file.robot.roles).find()
    for name in robot_file.parameters:
        if name not in found:
            raise PluginMissing(name, f"[parameters.{name}]: no plugin of that name; there are: {', '.join(found)}")
    waiting = sorted(found) if robot_file.robot.load is None else list(robot_file.robot.load)
    manifests: dict[str, Manifest] = {}
    while waiting:
        name = waiting.pop(0)
        if name in manifests:
            continue
        if name not in found:
            raise PluginMissing(name, f"no plugin {name} in any place; there are: {', '.join(sorted(found))}")
        manifests[name] = read_manifest(found[name])
        waiting += [required for required in manifests[name].tag.requires if required in found]
    return list(manifests.values())


def _is_device(manifest: Manifest) -> bool:
    try:
        return import_class(manifest).level is Level.DEVICE
    except (PackageMissing, ManifestError):
        return False  # `check_extras` reports it


def _check_interface(channel: str, plugins: list[str], network: Path) -> Check:
    users = ", ".join(plugins)
    try:
        flags = int((network / channel / "flags").read_text(), 16)
    except (OSError, ValueError):
        return wrong(
            CheckName.CAN,
            f"there is no CAN interface {channel} (needed by {users})",
            f"plug in the adapter and load its driver (`ip link show type can`), or name another channel in "
            f"[parameters.{plugins[0]}]",
        )
    if not flags & IFF_UP:
        return wrong(
            CheckName.CAN,
            f"the CAN interface {channel} (needed by {users}) is down",
            f"ip link set {channel} up type can bitrate 500000",
        )
    return good(CheckName.CAN, f"the CAN interface {channel} of {users} is up")


class OwnCertificate(NamedTuple):
    """Certificate that a process must present."""

    member: Member | None
    """Member of the certificate; None accepts that of any member."""
    folder: Path | None
    """As `robrain pki issue` made it; None if none is given."""


def check_certificates(wanted: Sequence[OwnCertificate], endpoints: Sequence[str]) -> list[Check]:
    """A check for each certificate; none if no endpoint asks for one."""
    if not any(map(is_secured, endpoints)):
        return []
    return [check_certificate(one, datetime.now(UTC)) for one in wanted]


def check_certificate(wanted: OwnCertificate, now: datetime) -> Check:
    """Whether a certificate is there, can be read by its owner alone, is valid, and is the one that is wanted."""
    member, folder = wanted
    issue = f"`robrain pki issue {member.role} {member.name}`" if member else "`robrain pki issue`"
    if folder is None:
        return wrong(
            CheckName.CERTIFICATE,
            "the router asks for a certificate, and none is given",
            f"give `robrain --tls FOLDER`, {TLS_VARIABLE} or folder in [zenoh.tls]; {issue} makes such a folder",
        )
    try:
        shown = read_identity(folder, now)
    except WireError as error:
        return wrong(CheckName.CERTIFICATE, str(error), f"copy the folder that {issue} or `robrain pki renew` made")
    if member is not None and shown.member != member:
        return wrong(
            CheckName.CERTIFICATE,
            f"{folder}: expected the certificate of {member.common_name}, got that of {shown.member.common_name}",
            f"copy the folder that {issue} made",
        )
    warning = shown.warning(now)
    return good(
        CheckName.CERTIFICATE,
        warning or f"{folder} has the certificate of {shown.member.common_name}",
        "copy the renewed folder over it; the next connection uses it" if warning else "",
    )


class JoinRequest(NamedTuple):
    """Endpoints, team and names of a machine that joins."""

    endpoints: Sequence[str]
    team: str
    robots: Sequence[str]
    """Names whose keys and claims are checked."""
    certificates: Sequence[OwnCertificate] = ()
    """Certificates for endpoints that require them."""


def examine_hub(connect: str | None, team: str | None) -> list[Check]:
    """The hub of this machine, or the one given."""
    shown = [OwnCertificate(None, tls_folder())]
    return examine_team(JoinRequest(team_endpoints(connect), team or DEFAULT_TEAM, [], shown))


def examine_robot(path: Path, connect: str | None, team: str | None) -> list[Check]:
    """A robot, by its file; the certificate that it names is shown by this process too from then on.

    Args:
        path: its ROBOT.toml.
        connect: endpoint; None uses the file's, or else this machine's hub.
        team: None uses the file's.

    """
    found, of_file = check_robot_file(path)
    if found is None:
        return [of_file]
    table, settings = found.robot_file.robot, found.robot_file.zenoh
    here = [of_file, check_extras(found), *check_can(found), check_grid(found), *check_robot_ports(found)]
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
        devices = [unknown(CheckName.DEVICE, f"the devices are not opened: {table.name} runs and has them open")]
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
        return [wrong(CheckName.FILE, str(error), "correct the file, or give --host")]
    checks = [good(CheckName.FILE, f"{path} is a team file; host {host.name} has {', '.join(host.parts)}")]
    checks.append(check_address(host.name, host.address))
    if team_file.team.scenario:
        checks.append(_check_scenario(path, team_file, host))
    for name in host.robots:
        if name in team_file.robots:
            found, of_file = check_robot_file(path.parent / team_file.robots[name])
            checks.append(of_file)
            if found is not None:
                checks += [check_extras(found), *check_can(found), check_grid(found), *check_robot_ports(found)]
    shown, as_member = _certificates_of(path, team_file, host)
    with as_member:
        if HUB in host.parts:
            checks.append(check_port("the hub", team_file.endpoint))
            if not check_router([team_file.endpoint]).ok:  # not started yet: there is no team to check
                return [*checks, *check_certificates(shown, [team_file.endpoint])]
        # As an operator one sees all of a secured team, and may not try its robots' keys.
        robots = [] if shown else host.robots
        return [*checks, *examine_team(JoinRequest([team_file.endpoint], team_file.team.name, robots, shown))]


def _certificates_of(
    path: Path, team_file: TeamFile, host: HostTable
) -> tuple[list[OwnCertificate], AbstractContextManager[None]]:
    """Certificates of a machine's parts, and the time for which this process presents the operator's certificate."""
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
    """Checks that a client of the team's router can make."""
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
                checks += [check_robot(robot) for robot in status_by(wire).statuses]
            checks.append(check_clock(stamp_skews_s(session, joining.team)))
            checks.append(check_versions(version("robrain"), members(session, joining.team)))
            checks += [check_name_free(robot, holders(session, joining.team, robot)) for robot in joining.robots]
    except RobrainError as error:  # the router has gone meanwhile
        checks.append(wrong(CheckName.ROUTER, str(error), "look at the router"))
    return checks


def _check_scenario(path: Path, team_file: TeamFile, host: HostTable) -> Check:
    """Whether the scenario, and the map that it names, can be loaded here: for the arena and the robots' files."""
    name = team_file.team.scenario
    try:
        from robrain.deploy.command_line.scenario_choice import choose_scenario

        where = str(path.parent / name) if name.endswith(".toml") or "/" in name else name
        known = [robot.name for robot in choose_scenario(where, None, None, None, None).world().robots]
    except ModuleNotFoundError as error:
        missing = missing_package(error)
        if missing is None:
            raise
        needed = f"'{missing.needed}'" if missing.extra else missing.package
        return wrong(
            CheckName.EXTRA,
            f"the scenario {name} needs {missing.package}, which is not installed",
            f"pip install {needed}",
        )
    except RobrainError as error:
        return wrong(CheckName.MAP, str(error), f"correct the scenario {name}, or copy its map here")
    unknown = [robot for robot in host.robots if robot not in known and robot not in team_file.robots]
    if unknown:
        return wrong(
            CheckName.FILE,
            f"the scenario {name} has no robot {unknown[0]}; it has {', '.join(known)}",
            f"name one of these in the parts of host {host.name}, or give its file in [robots]",
        )
    what = "simulates it" if ARENA in host.parts else "knows it"
    return good(CheckName.MAP, f"the scenario {name} and its map are there; host {host.name} {what}")


def doctor_command(
    file: Path | None, host: str | None, connect: str | None, team: str | None, *, as_json: bool
) -> bool:
    """Check, and print the results; whether no check failed.

    Args:
        file: a ROBOT.toml or a team file; None checks a hub alone.
        host: of a team file: which machine.
        connect: endpoint of the team; not with a team file.
        team: its name; not with a team file.
        as_json: print an array of checks.

    Raises:
        UsageError: the options do not fit the file.

    """
    if file is not None and is_team_file(file):
        if connect is not None or team is not None:
            raise UsageError(f"--connect, --team: not allowed here, because the team file {file} sets them")
        checks = examine_host(file, host)
    elif host is not None:
        raise UsageError(f"--host {host}: expected a team file with [[hosts]]")
    else:
        checks = examine_robot(file, connect, team) if file is not None else examine_hub(connect, team)
    if as_json:
        print_json(checks)
    else:
        for check in checks:
            print_line(f"{MARKS[check.ok]:<8}{check.name.value}: {check.sentence}")
            if check.remedy:
                print_line(f"{'':<8}  {check.remedy}")
    return is_good(checks)
