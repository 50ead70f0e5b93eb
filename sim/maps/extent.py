"""Limits on the size of a floor that a team of robots can map."""

from robrain.protocol.wire.messages.map_patch import MAX_CELLS as MAX_TEAM_CELLS

TEAM_RESOLUTION_M = 0.1
"""Pitch of the team's grid on a simulated floor."""
MAX_CELLS = 20_000_000
"""Largest number of cells of a floor plan."""
MAX_AREA_M2 = MAX_TEAM_CELLS * TEAM_RESOLUTION_M**2
MAX_ORIGIN_M = 1e5
"""Largest distance of a floor's origin from 0, along each axis."""


def why_too_large(width_m: float, height_m: float) -> str:
    """The error text for a floor too large to map; empty if a team can map it."""
    if width_m * height_m <= MAX_AREA_M2:
        return ""
    return f"expected a floor of at most {MAX_AREA_M2:.0f} m², got {width_m:g} × {height_m:g} m"
