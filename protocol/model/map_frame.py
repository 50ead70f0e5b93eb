"""Map frames: in which coordinates a robot, and each submap, is placed.

A robot that knows its place works in the arena frame, the team's. A robot whose start is unknown, or that was carried
off, begins a separate frame and maps in it. It moves its submaps into the team's frame when it has found the transform
between the two.
"""

import msgspec

from robrain.protocol.model.ranges import Count, Name


class MapFrame(msgspec.Struct, frozen=True, order=True):
    """The arena frame by default; otherwise the frame that a robot began with one of its submaps.

    Frames are ordered: a robot moves from a greater frame to a smaller one, never back. The arena frame is the least,
    and of two others it is the one that was begun first.
    """

    since: Count = 0
    """Number of the submap with which the frame began; 0 for the arena frame."""
    robot: Name = ""
    """The robot that began it; empty for the arena frame."""


ARENA = MapFrame()
