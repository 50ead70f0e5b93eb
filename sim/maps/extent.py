"""How large a floor may be: a team of robots must be able to map it."""

from robrain.protocol.wire.map_patch import MAX_CELLS as MAX_TEAM_CELLS

TEAM_RESOLUTION_M = 0.1
"""Pitch of the grid that a team maps a simulated floor on."""
MAX_CELLS = 20_000_000
"""Of a floor plan."""
MAX_AREA_M2 = MAX_TEAM_CELLS * TEAM_RESOLUTION_M**2
MAX_ORIGIN_M = 1e5
"""A floor's origin lies no farther from 0 than this, along each axis."""


def why_too_large(width_m: float, height_m: float) -> str:
    """What is expected of a floor and what this one is; empty if a team can map it."""
    if width_m * height_m <= MAX_AREA_M2:
        return ""
    return f"expected a floor of at most {MAX_AREA_M2:.0f} m², got {width_m:g} × {height_m:g} m"
