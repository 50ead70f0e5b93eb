"""`robrain zone`: show and change the zones of a running team."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp, ConnectTeam, Shown
from robrain.deploy.errors import UsageError
from robrain.protocol.model.zone import Zone

zone_app = CommandApp(OPERATE, "zone", "Show and change zones: keep-out areas, speed limits, areas to avoid.")


@zone_app.team_command("list")
def list_zones(connect: ConnectTeam) -> Shown:
    """List the team's zones, and when those with times begin or end next."""
    zones = connect().zone_times()
    return _shown(zones.all, [", ".join(filter(None, (_text_of(zone), zones.turn_text(zone)))) for zone in zones.all])


@zone_app.team_command()
def put(
    connect: ConnectTeam, file: Annotated[Path, typer.Argument(help="TOML file with [[planning.zones]].")]
) -> Shown:
    """Add the zones of a file; they replace zones with the same names."""
    from robrain.deploy.processes.table_files import read_planning

    zones = read_planning(file, "FILE").zones
    if not zones:
        raise UsageError(f"FILE {file}: expected at least one table [[planning.zones]]")
    return _shown(connect().change_zones(*zones))


@zone_app.team_command()
def mask(
    connect: ConnectTeam,
    name: Annotated[str, typer.Argument(help="Name of the zone.")],
    file: Annotated[Path, typer.Argument(help="YAML file of a mask of Nav2's costmap filters.")],
    speed: Annotated[
        tuple[float, float] | None, typer.Option(help="BASE MULTIPLIER of a speed mask. Default: a keep-out mask.")
    ] = None,
    fastest_m_s: Annotated[
        float | None, typer.Option("--percent-of", min=1e-3, help="Its limits are per cent of this speed, m/s.")
    ] = None,
) -> Shown:
    """Add the zones of a Nav2 mask; they replace zones with the same names."""
    from robrain.sim.maps.zone_masks import SpeedScale, zones_of_mask

    try:
        zones = zones_of_mask(file, name, None if speed is None else SpeedScale(*speed, fastest_m_s))
    except ValueError as error:
        raise UsageError(f"FILE {file}: {error}") from error
    return _shown(connect().change_zones(*zones))


@zone_app.team_command()
def remove(
    connect: ConnectTeam, names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")]
) -> Shown:
    """Remove zones."""
    return _shown(connect().change_zones(remove=names))


def _shown(zones: Sequence[Zone], lines: Sequence[str] = ()) -> Shown:
    return zones, lines or [*map(_text_of, zones)] or ["the team has no zones"]


@zone_app.team_command()
def clear(
    connect: ConnectTeam,
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")],
    for_s: Annotated[
        float | None, typer.Option("--for-s", min=1.0, help="Seconds after which they open. Default: until zone open.")
    ] = None,
) -> Shown:
    """Have all robots leave zones and wait outside. Tasks there and behind them wait."""
    return _shown(connect().clear_zones(*names, for_s=for_s))


@zone_app.team_command("open")
def open_(
    connect: ConnectTeam, names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of zones.")]
) -> Shown:
    """Open zones that are cleared."""
    return _shown(connect().open_zones(*names))


def _text_of(zone: Zone) -> str:
    who = f", for {', '.join(zone.robots)}" if zone.robots else ""
    return f"{zone.name}: {zone.rule}{f', {zone.area_m2:.1f} m²' if zone.area_m2 else ''}{who}"
