"""`robrain door`: operate a door that robots request, by Modbus TCP."""

from typing import Annotated

import typer

from robrain.client.door_keeper import DoorKeeper
from robrain.deploy.command_line.command_group import CONNECT, CommandApp
from robrain.deploy.command_line.options import ConnectOption, TeamOption
from robrain.deploy.command_line.output import print_result
from robrain.deploy.processes.live_process import LiveStop, wire_when_there
from robrain.protocol.clock import steps
from robrain.protocol.keys import DEFAULT_TEAM, check_name

STEP_S = 0.1
ADDRESS_MAX = 65_535
door_app = CommandApp(CONNECT)


@door_app.command()
def door(
    name: Annotated[str, typer.Argument(help="Name of the door's zone.")],
    host: Annotated[str, typer.Argument(help="Host of the Modbus TCP controller.")],
    port: Annotated[int, typer.Option(help="Its port.", min=1, max=ADDRESS_MAX)] = 502,
    coil: Annotated[int, typer.Option(help="Coil that orders it to open.", min=0, max=ADDRESS_MAX)] = 0,
    input_: Annotated[int, typer.Option("--input", help="Input that is on while open.", min=0, max=ADDRESS_MAX)] = 0,
    unit: Annotated[int, typer.Option(help="Device behind the controller.", min=0, max=255)] = 1,
    opening_s: Annotated[float, typer.Option(help="Seconds that it usually takes to open.", min=0.0)] = 5.0,
    timeout_s: Annotated[float, typer.Option(help="Seconds after which it has failed.", min=1.0)] = 20.0,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
) -> None:
    """Open a door while robots request it, until Ctrl-C; wait until the team's endpoint answers."""
    from robrain.deploy.processes.modbus_door import ModbusDoor

    should_stop = LiveStop()
    with wire_when_there("door", connect, check_name("team", team), should_stop) as wire:
        if wire is None:
            return
        driver = ModbusDoor(host, port, coil=coil, input_=input_, unit=unit)
        keeper = DoorKeeper(check_name("door", name), driver, wire, opening_s=opening_s, timeout_s=timeout_s)
        print_result(f"door: {name} of team {team} at {host}:{port}")
        try:
            for _ in steps(should_stop, STEP_S):
                keeper.step()
        finally:
            driver.disconnect()
