"""`robrain arena`: the simulator in real time, and the files of the robots that it simulates."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import msgspec
import zenoh

from robrain.agent.host.robot_file import RobotFile
from robrain.deploy.command_line.options import make_folder
from robrain.deploy.command_line.output import print_result
from robrain.deploy.command_line.terminal import own_command, print_progress
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import forwarder_line
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.deploy.processes.live_process import LiveStop, Place, live_endpoint, open_hub, open_when_there
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.session import is_loopback, listening_at
from robrain.sim.firmware.described_controller import BASE_LINE
from robrain.sim.firmware.lidar_line import LINE, LidarProtocol
from robrain.sim.firmware.line_plug import LinePlug
from robrain.sim.firmware.wit_imu import IMU_LINE
from robrain.sim.motes.serial_forwarder import SerialForwarder
from robrain.sim.robot.robot_hardware import ArenaRobot, Controller
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.arena import Arena
from robrain.sim.world.robot_specs import BASE_PLUGIN, IMU_PLUGIN, LIDAR_PLUGIN
from robrain.sim.world.world import World

MOVED_ON = {"start_known": True, "start_sigma_m": 0.2, "start_sigma_rad": 0.1}
"""Uncertainty of the last pose that a robot reported: it drives on for 0.2 s, until its base stops by itself."""
PLUGINS = MappingProxyType({LINE: LIDAR_PLUGIN, BASE_LINE: BASE_PLUGIN, IMU_LINE: IMU_PLUGIN})
"""Serial lines, by the robots' parameter `port`."""
NO_FORWARDERS: Mapping[str, str] = MappingProxyType({})


def loadable_from_here(endpoints: Sequence[str]) -> list[Path]:
    """Folders to load plugins from while robots run: the working folder, if only this machine can reach the team.

    Empty if other machines can reach the team, or if that folder is the root of the disk.
    """
    here = Path.cwd()
    is_private = bool(endpoints) and all(map(is_loopback, endpoints))
    return [here] if is_private and here != Path(here.root) else []


def write_robot_files(
    world: World,
    folder: Path,
    *,
    team: str,
    connect: str,
    forwarders: Mapping[str, str] = NO_FORWARDERS,
    loadable: Sequence[Path] = (),
    lines: Sequence[LinePlug] = (),
) -> list[Path]:
    """Write one file per robot into a folder.

    Args:
        world: start poses of the robots, and the grid of their maps.
        folder: it must exist.
        team: the robots' team.
        connect: endpoint that their agents connect to.
        forwarders: `host:port` of the robots' Serial Forwarders, written as a comment.
        loadable: folders from which plugins may be loaded while the robots run.
        lines: serial lines of the robots.

    """
    files = [
        robot_file_of(world, robot, team=team, connect=connect, loadable=loadable, lines=lines)
        for robot in world.robots
    ]
    return [write_robot_file(robot_file, folder, forwarders) for robot_file in files]


def robot_file_of(
    world: World,
    robot: ArenaRobot,
    *,
    team: str,
    connect: str,
    loadable: Sequence[Path] = (),
    lines: Sequence[LinePlug] = (),
) -> RobotFile:
    """The file of one robot; the arguments are those of `write_robot_files`."""
    robot_file = world.robot_file(robot, team=team, connect=(connect,))
    parameters = dict(robot_file.parameters)
    for plug in lines:
        if plug.robot == robot.name:
            plugin = PLUGINS[plug.line]
            parameters[plugin] = {**parameters.get(plugin, {}), "port": str(plug.path.absolute())}
    table = msgspec.structs.replace(robot_file.robot, loadable=[str(each) for each in loadable])
    return msgspec.structs.replace(robot_file, robot=table, parameters=parameters)


def write_robot_file(robot_file: RobotFile, folder: Path, forwarders: Mapping[str, str] = NO_FORWARDERS) -> Path:
    """Write one file into a folder; returns its path."""
    name, comment = robot_file.robot.name, ""
    if address := forwarders.get(name):
        host, _, port = address.partition(":")
        comment = (
            "# While this arena runs, a Serial Forwarder of the robot's base station is at "
            f"{address}. To go by it:\n"
            f'# [parameters.mote_base]\n# interface = "sf"\n# host = "{host}"\n# port = {port}\n\n'
        )
    path = folder / f"{name}.toml"
    path.write_bytes(comment.encode() + msgspec.toml.encode(robot_file))
    return path


def started_again(robot_file: RobotFile, pose: Pose2D | None) -> RobotFile:
    """The file for an agent that is restarted during the run.

    Args:
        robot_file: of its first start.
        pose: last reported pose of the robot, arena frame. None if it had lost its place: then it finds out by the map
            of the others or by motes.

    """
    known = {"start_known": False} if pose is None else {**msgspec.structs.asdict(pose), **MOVED_ON}
    parameters = dict(robot_file.parameters)
    parameters["localisation"] = {**parameters.get("localisation", {}), **known}
    return msgspec.structs.replace(robot_file, parameters=parameters)


def open_lines(endpoint: Endpoint, world: World, folder: Path, closing: ExitStack) -> list[LinePlug]:
    """The robots' serial lines as pseudo terminals, such as `r1-lidar` in a folder; closed with `closing`."""
    plugs = []
    for robot in world.robots:
        lines = [LINE] if robot.lidar.protocol is not LidarProtocol.WIRE else []
        lines += [BASE_LINE] if robot.controller is Controller.LINES else []
        lines += [IMU_LINE] if robot.imu is not None else []
        for line in lines:
            plug = LinePlug(endpoint, robot.name, line, folder / f"{robot.name}-{line}")
            closing.callback(plug.close)
            plugs.append(plug)
    return plugs


BYTES_MAX = 16 * 1024 * 1024


def write_resume(path: Path, truth: ArenaTruth) -> Path:
    """Write where the robots are; returns the path."""
    path.write_bytes(msgspec.json.encode({robot.robot: robot.pose for robot in truth.robots}))
    return path


def resumed(world: "World", path: Path) -> "World":
    """The world with its robots at the poses of a file; robots that it does not name stay at their starts.

    Raises:
        UsageError: the file cannot be read.

    """
    try:
        with path.open("rb") as file:
            poses = msgspec.json.decode(file.read(BYTES_MAX), type=dict[str, Pose2D])
    except (OSError, msgspec.MsgspecError) as error:
        raise UsageError(f"--resume {path}: {error}") from error
    robots = [msgspec.structs.replace(robot, start=poses.get(robot.name, robot.start)) for robot in world.robots]
    return replace(world, robots=robots)


CATCH_UP_S = 0.5


def arena_command(
    scenario: Scenario, place: Place, team: str, robot_files: Path | None, resume: Path | None = None
) -> None:
    """Simulate a scenario until Ctrl-C.

    Args:
        scenario: the scenario to simulate.
        place: endpoints to connect or listen; without either, the arena is this machine's hub.
        team: its name.
        robot_files: folder for a ROBOT.toml of each robot.
        resume: file with the poses at which the robots continue, written by `robrain up` when an arena has ended.

    Raises:
        RobrainError: in one sentence.

    """
    world = scenario.world()
    world.check_live()
    if resume is not None:
        world = resumed(world, resume)
    prepare_kernels()
    should_stop = LiveStop()
    with ExitStack() as closing:
        session = _open(place, should_stop)
        if session is None:
            return
        closing.callback(session.close)
        wire = closing.enter_context(live_endpoint(session, team))
        where = place.connect or listening_at(session)
        forwarders = [SerialForwarder(wire, robot.name) for robot in world.robots]
        for forwarder in forwarders:
            closing.callback(forwarder.close)
        listening = {forwarder.robot: "{}:{}".format(*forwarder.address) for forwarder in forwarders}
        lines: list[LinePlug] = []
        if robot_files is not None:
            make_folder(robot_files)
            lines = open_lines(wire, world, robot_files, closing)
            for path in write_robot_files(
                world,
                robot_files,
                team=team,
                connect=where[0],
                forwarders=listening,
                loadable=loadable_from_here(where),
                lines=lines,
            ):
                print_progress(own_command("agent", path))
        arena = Arena(world, wire)
        try:
            names = ", ".join(robot.name for robot in world.robots)
            for robot, address in listening.items():
                print_result(forwarder_line(robot, address))
            print_result(f"arena: {scenario.name} at {', '.join(where)}, robots {names}; Ctrl-C ends it")
            should_stop.ready()
            run_arena(arena, should_stop, [*forwarders, *lines])
        finally:
            arena.close()


def _open(place: Place, should_stop: LiveStop) -> zenoh.Session | None:
    if place.connect:
        return open_when_there("arena", place.connect, should_stop)
    session, other = open_hub(place.listen[0] if place.listen else None)
    if other:
        print_progress(f"arena: {other} is taken, listening elsewhere: other commands need --connect")
    return session


def run_arena(arena: Arena, should_stop: Callable[[], bool], lines: Sequence[SerialForwarder | LinePlug]) -> None:
    """Step an arena, and its lines to others, in real time until `should_stop()`.

    After a pause of the machine the arena catches up at most half a second. The simulated world loses the rest of the
    time, so that it does not race.
    """
    due_s = time.monotonic()
    while not should_stop():
        arena.step()
        for line in lines:
            line.step()
        due_s += arena.tick_s
        ahead_s = due_s - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -CATCH_UP_S:
            due_s = time.monotonic()
