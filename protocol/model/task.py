"""Tasks: what a robot can be asked to do, and the states that it goes through."""

from enum import StrEnum

import msgspec

from robrain.protocol.model.geometry import Point2D


class TaskState(StrEnum):
    """`queued → offered → running → done | failed | cancelled`; `lost_contact` is apart from failed."""

    QUEUED = "queued"
    OFFERED = "offered"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    LOST_CONTACT = "lost_contact"

    @property
    def ended(self) -> bool:
        """Nothing follows this state."""
        return self in (TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED)


class Explore(msgspec.Struct, frozen=True, kw_only=True, tag="explore"):
    """Go to a border of the known and see what lies behind it."""

    id: str
    goal: Point2D
    """Arena frame."""


Task = Explore
"""The tagged union of everything a robot can be asked to do."""
