"""Names of a recording's channels beside those of the wire, for Foxglove, Lichtblick and Rerun.

They are derived from recorded messages and can be made again at any time, so replay, digest and comparison skip them.
"""

PREFIX = "/visual/"
ROBOTS = PREFIX + "robots"
WALLS = PREFIX + "walls"
WALL_POINTS = PREFIX + "wall_points"
TASKS = PREFIX + "tasks"
MOTES = PREFIX + "motes"
TRANSFORMS = PREFIX + "tf"
MAP = PREFIX + "map"
LOG = PREFIX + "log"


def of_robot(robot: str, what: str) -> str:
    """Channel of one robot: `scan`, `points`, `pose`, `trail`, `path`, `battery`."""
    return f"{PREFIX}{robot}/{what}"


def is_visual(channel: str) -> bool:
    """Whether a channel was derived, and never was on the wire."""
    return channel.startswith(PREFIX)
