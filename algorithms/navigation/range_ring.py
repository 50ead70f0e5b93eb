"""The ring of range sensors and the ring of bump contacts: how they are numbered, on both sides of the bus.

Sensors and contacts count counter-clockwise from straight ahead, in the robot's frame. Six sensors and eight contacts
are chosen; the frames of `robertino.dbc` carry up to twelve and eight.
"""

import math

RING_ANGLES_RAD = tuple(math.tau * sensor / 6 for sensor in range(6))
SENSORS_A_FRAME = 6
SENSORS_MAX = 12
NO_ECHO_M = 2.55
"""What a frame says for "nothing heard"."""
BUMP_SECTORS = 8
"""A contact each; the first looks straight ahead, and covers 22.5° to either side."""


def bump_sector(direction_rad: float) -> int:
    """The contact that a touch from this direction of the robot's frame presses.

    >>> [bump_sector(angle) for angle in (0.0, 0.5, math.pi, -0.5)]
    [0, 1, 4, 7]
    """
    return round(direction_rad * BUMP_SECTORS / math.tau) % BUMP_SECTORS


def bump_directions_rad(contacts: int) -> list[float]:
    """Where the contacts look that are pressed, in (−π, π], from the bits of a frame.

    >>> bump_directions_rad(0b100) == [math.pi / 2]
    True
    """
    return [
        math.remainder(math.tau * sector / BUMP_SECTORS, math.tau)
        for sector in range(BUMP_SECTORS)
        if contacts >> sector & 1
    ]
