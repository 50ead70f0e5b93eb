"""`robrain zone`: show and change the zones of a running team."""

from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE
from robrain.deploy.command_line.options import ConnectOption, JsonOption, TeamOption, connect_team
from robrain.deploy.command_line.output import print_either
from robrain.deploy.errors import UsageError
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.model.zone import Zone

zone_app = typer.Typer(
    rich_help_panel=OPERATE,
    name="zone",
    help="Show and change zones: keep-out areas, speed limits, areas to avoid.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@zone_app.command("list")
def list_zones(connect: ConnectOption = None, team: TeamOption = DEFAULT_TEAM, as_json: JsonOption = False) -> None:
    """List the team's zones, and when those with times begin or end next."""
    with connect_team(connect, team) as client:
        zones = client.zone_times()
    lines = [", ".join(filter(None, (_text_of(zone), zones.turn_text(zone)))) for zone in zones.all]
    print_either(zones.all, lines or ["the team has no zones"], as_json=as_json)


@zone_app.command()
def put(
    file: Annotated[Path, typer.Argument(help="TOML file with [[planning.zones]].")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Add the zones of a file; they replace zones with the same names."""
    from robrain.deploy.processes.table_files import read_planning

    zones = read_planning(file, "FILE").zones
    if not zones:
        raise UsageError(f"FILE {file}: expected at least one table [[planning.zones]]")
    with connect_team(connect, team) as client:
        known = client.change_zones(*zones)
    print_either(known, [_text_of(zone) for zone in known], as_json=as_json)


@zone_app.command()
def mask(
    name: Annotated[str, typer.Argument(help="Name of the zone.")],
    file: Annotated[Path, typer.Argument(help="YAML file of a mask of Nav2's costmap filters.")],
    speed: Annotated[
        tuple[float, float] | None, typer.Option(help="BASE MULTIPLIER of a speed mask. Default: a keep-out mask.")
    ] = None,
    fastest_m_s: Annotated[
        float | None, typer.Option("--percent-of", min=1e-3, help="Its limits are per cent of this speed, m/s.")
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Add the zones of a Nav2 mask; they replace zones with the same names."""
    from robrain.sim.maps.zone_masks import SpeedScale, zones_of_mask

    try:
        zones = zones_of_mask(file, name, None if speed is None else SpeedScale(*speed, fastest_m_s))
    except ValueError as error:
        raise UsageError(f"FILE {file}: {error}") from error
    with connect_team(connect, team) as client:
        known = client.change_zones(*zones)
    print_either(known, [_text_of(zone) for zone in known], as_json=as_json)


@zone_app.command()
def remove(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Remove zones."""
    with connect_team(connect, team) as client:
        known = client.change_zones(remove=names)
    print_either(known, [_text_of(zone) for zone in known] or ["the team has no zones"], as_json=as_json)


@zone_app.command()
def clear(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")],
    for_s: Annotated[
        float | None, typer.Option("--for-s", min=1.0, help="Seconds after which they open. Default: until zone open.")
    ] = None,
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Have all robots leave zones and wait outside. Tasks there and behind them wait."""
    with connect_team(connect, team) as client:
        known = client.clear_zones(*names, for_s=for_s)
    print_either(known, [_text_of(zone) for zone in known], as_json=as_json)


@zone_app.command("open")
def open_(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")],
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    as_json: JsonOption = False,
) -> None:
    """Open zones that are cleared."""
    with connect_team(connect, team) as client:
        known = client.open_zones(*names)
    print_either(known, [_text_of(zone) for zone in known], as_json=as_json)


def _text_of(zone: Zone) -> str:
    who = f", for {', '.join(zone.robots)}" if zone.robots else ""
    return f"{zone.name}: {zone.rule}{f', {zone.area_m2:.1f} m²' if zone.area_m2 else ''}{who}"
