"""`robrain vda5050 …`: options."""

import re
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import CONNECT, CommandApp
from robrain.deploy.command_line.options import ConnectOption, TeamOption, point
from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.messages import Vehicle, Version
from robrain.protocol.keys import DEFAULT_TEAM, check_name
from robrain.protocol.model.geometry import Pose2D

vda5050_app = CommandApp(CONNECT, "vda5050", "VDA 5050, both ways.")

BrokerOption = Annotated[str, typer.Option(help="MQTT broker, HOST:PORT.")]
LoginOption = Annotated[Path | None, typer.Option(help="File with USER:PASSWORD for the broker.")]
CaOption = Annotated[Path | None, typer.Option(help="PEM file of the broker's authorities; turns TLS on.")]
VersionOption = Annotated[Version, typer.Option(help="Version of VDA 5050.")]
MapOffsetOption = Annotated[str, typer.Option(help="Origin of the vehicles' map in the arena frame, X,Y in metres.")]
MapYawOption = Annotated[float, typer.Option(help="Direction of that map's x axis in the arena frame, radians.")]
MANUFACTURER = re.compile(r"[^/+#$\s]{1,64}")
SERIAL = re.compile(r"[A-Za-z0-9_.:\-]{1,64}")
"""By the standard."""


@vda5050_app.command()
def vehicle(
    address: Annotated[str, typer.Argument(help="The vehicle, MANUFACTURER/SERIAL.")],
    name: Annotated[str, typer.Option(help="Name of the robot in the team.")],
    broker: BrokerOption,
    login: LoginOption = None,
    ca: CaOption = None,
    version: VersionOption = Version.V2_1,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    map_id: Annotated[str, typer.Option(help="Id of its map; default: the map that it reports.")] = "",
    map_offset: MapOffsetOption = "0,0",
    map_yaw: MapYawOption = 0.0,
    radius: Annotated[float, typer.Option(help="Radius of its footprint, metres.", min=0.0, max=100.0)] = 0.5,
    continues_for: Annotated[
        float,
        typer.Option(
            help="Seconds for which it continues its order without the coordinator or this process. No other robot "
            "gets its task in this time.",
            min=0.0,
            max=86_400.0,
        ),
    ] = 30.0,
) -> None:
    """Make a vehicle of another vendor a robot of the team: it does tasks to visit and to patrol."""
    shown = read_address(address, version, map_id, map_offset, map_yaw)
    from robrain.deploy.vda5050.mqtt_link import Broker
    from robrain.deploy.vda5050.vehicle_process import VehicleRobot, vehicle_command

    robot = VehicleRobot(check_name("robot", name), shown, radius, continues_for)
    vehicle_command(robot, Broker.read(broker, login, ca), connect, check_name("team", team))


@vda5050_app.command()
def fleet(
    broker: BrokerOption,
    login: LoginOption = None,
    ca: CaOption = None,
    version: VersionOption = Version.V2_1,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    manufacturer: Annotated[str, typer.Option(help="Manufacturer of the vehicles.")] = "robrain",
    map_id: Annotated[str, typer.Option(help="Id of their map.")] = "arena",
    map_offset: MapOffsetOption = "0,0",
    map_yaw: MapYawOption = 0.0,
    orders: Annotated[
        Path | None, typer.Option(help="Folder for the current orders; default: TEAM.vda5050 in this folder.")
    ] = None,
) -> None:
    """Show the robots as vehicles to a VDA 5050 master, and do its orders."""
    check_name("team", team)
    shown = read_address(f"{manufacturer}/robot", version, map_id, map_offset, map_yaw)
    from robrain.deploy.vda5050.fleet_process import fleet_command
    from robrain.deploy.vda5050.mqtt_link import Broker

    fleet_command(connect, team, Broker.read(broker, login, ca), shown, orders or Path(f"{team}.vda5050"))


def read_address(text: str, version: Version, map_id: str, map_offset: str, map_yaw_rad: float) -> Vehicle:
    """Read `MANUFACTURER/SERIAL` and the place of the map (UsageError)."""
    manufacturer, _, serial = text.partition("/")
    if not MANUFACTURER.fullmatch(manufacturer) or not SERIAL.fullmatch(serial):
        raise UsageError(f"{text}: expected MANUFACTURER/SERIAL, such as acme/0001")
    return Vehicle(version, manufacturer, serial, map_id, Pose2D(*point("--map-offset", map_offset), map_yaw_rad))
