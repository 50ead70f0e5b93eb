"""Checks of a robot's own machine: its file, its CAN buses, its devices, the packages that its plugins need."""

import importlib.metadata
import logging
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from robrain.agent.class_import import import_class
from robrain.agent.errors import ManifestError, PackageMissing, PluginMissing, RobotFileError
from robrain.agent.host.agent_host import AgentHost, stock_place
from robrain.agent.host.robot_file import RobotFile, folder_of, read_robot_file
from robrain.agent.lifecycle.plugin_folders import PluginFolders, entry_point_places
from robrain.agent.manifest import Manifest, read_manifest
from robrain.agent.plugin import Level
from robrain.deploy.doctor.check import Check, CheckName
from robrain.deploy.doctor.network_checks import check_port
from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import listening_at, open_session

SOCKETCAN = "socketcan"
NETWORK = Path("/sys/class/net")
IFF_UP = 1
"""Of an interface's flags, netdevice(7)."""
MAPPER = "mapper"
GRID = ("resolution_m", "origin_x_m", "origin_y_m", "width_m", "height_m")


class RobotFound(NamedTuple):
    """What a robot's file says."""

    robot_file: RobotFile
    manifests: list[Manifest]
    """Of the plugins that are loaded."""

    def parameters(self, manifest: Manifest) -> Mapping[str, Any]:
        """Parameters of a plugin: those of the robot's file first."""
        return {**manifest.parameters, **self.robot_file.parameters.get(manifest.name, {})}


def check_robot_file(path: Path) -> tuple[RobotFound | None, Check]:
    """Whether a robot's file, and the manifests of its plugins, can be read."""
    try:
        robot_file = read_robot_file(path)
        manifests = _manifests(robot_file, path.parent)
    except (RobotFileError, ManifestError, PluginMissing) as error:
        return None, Check(CheckName.FILE, False, str(error), "correct the file")
    name = robot_file.robot.name
    return RobotFound(robot_file, manifests), Check(CheckName.FILE, True, f"{path} is a robot's file, of {name}")


def check_can(found: RobotFound, network: Path = NETWORK) -> list[Check]:
    """Whether the CAN interfaces of the robot's devices are there and up.

    Args:
        found: the robot.
        network: where Linux tells of network interfaces.

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
            return Check(CheckName.EXTRA, False, str(error), f"correct the plugin {manifest.name}")
    if not lacking:
        return Check(CheckName.EXTRA, True, f"the {len(found.manifests)} plugins have the packages that they need")
    said = "; ".join(f"{', '.join(names)} need {needed}" for needed, names in sorted(lacking.items()))
    installs = " ".join(f"'{needed}'" for needed in sorted(lacking))
    return Check(CheckName.EXTRA, False, f"packages are missing: {said}", f"pip install {installs}")


def check_devices(found: RobotFound, base: Path) -> list[Check]:
    """Whether each device opens what its parameters name, as at the start of the robot; all are closed at once.

    Args:
        found: the robot.
        base: folder of its file.

    """
    names = [manifest.name for manifest in found.manifests if _is_device(manifest)]
    if not names:
        return []
    table, checks = replace(found.robot_file.robot, load=names), list[Check]()
    logging.disable()  # the checks say what the log would
    try:
        with closing(open_session(mode="router", listen=["tcp/127.0.0.1:0"])) as session:
            zenoh = replace(found.robot_file.zenoh, connect=listening_at(session))
            robot_file = replace(found.robot_file, robot=table, zenoh=zenoh)
            host = AgentHost(robot_file, base, session, LiveClock(), Drive.LIVE)
            try:
                host.start()
                out = {each.name: each.why for each in host.manager.plugins.values() if not each.state.is_running}
                needing = {each.name for each in host.manager.plugins.values() if each.needs}
            finally:
                host.close()
    finally:
        logging.disable(logging.NOTSET)
    for name, why in out.items():
        if name not in needing:
            remedy = f"correct [parameters.{name}], or connect the device and give this user the right to open it"
            checks.append(Check(CheckName.DEVICE, False, f"{name} cannot start: {why}", remedy))
    if opened := [name for name in names if name not in out]:
        checks.append(
            Check(CheckName.DEVICE, True, f"devices that open what their parameters name: {', '.join(opened)}")
        )
    return checks


def check_grid(found: RobotFound) -> Check:
    """Whether the robot's file says which grid the team maps on: patches on another grid are refused."""
    mapper = next((manifest for manifest in found.manifests if manifest.name == MAPPER), None)
    if mapper is None:
        return Check(CheckName.MAP, True, "the robot makes no map")
    parameters = found.parameters(mapper)
    missing = [key for key in GRID if key not in found.robot_file.parameters.get(MAPPER, {})]
    size = f"{parameters['width_m']:g} × {parameters['height_m']:g} m"
    corner = f"({parameters['origin_x_m']:g}, {parameters['origin_y_m']:g})"
    if missing:
        return Check(
            CheckName.MAP,
            None,
            f"the file does not say on which map the robot works, so it is {size} from {corner}",
            f"every robot of a team needs the same map: give {', '.join(missing)} in [parameters.mapper]",
        )
    return Check(CheckName.MAP, True, f"the robot maps {size} from {corner}")


def check_robot_ports(found: RobotFound) -> list[Check]:
    """Whether the ports are free on which the robot and its `tcp_socket` listen."""
    listens = [(found.robot_file.robot.name, endpoint) for endpoint in found.robot_file.zenoh.listen]
    for manifest in found.manifests:
        parameters = found.parameters(manifest)
        if parameters.get("enabled") and parameters.get("port") and manifest.name == "tcp_socket":
            listens.append((manifest.name, f"tcp/{parameters.get('host', '127.0.0.1')}:{parameters['port']}"))
    return [check_port(what, endpoint) for what, endpoint in listens]


def own_version() -> str:
    """Version of this robrain."""
    return importlib.metadata.version("robrain")


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
        return Check(
            CheckName.CAN,
            False,
            f"there is no CAN interface {channel}, which {users} needs",
            f"plug in the adapter and load its driver (`ip link show type can`), or name another channel in "
            f"[parameters.{plugins[0]}]",
        )
    if not flags & IFF_UP:
        return Check(
            CheckName.CAN,
            False,
            f"the CAN interface {channel}, which {users} needs, is down",
            f"ip link set {channel} up type can bitrate 500000",
        )
    return Check(CheckName.CAN, True, f"the CAN interface {channel} of {users} is up")
