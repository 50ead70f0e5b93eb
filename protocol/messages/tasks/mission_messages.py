"""Missions of the team: what starts, lists and cancels them."""

from enum import StrEnum
from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.tasks.task_messages import TaskRequest
from robrain.protocol.model.ranges import Name, Names, Stamp, Text
from robrain.protocol.model.rules.mission import STEPS_MAX
from robrain.protocol.model.tasks.task import Parameters
from robrain.protocol.topic import Query, Urgency


class MissionState(StrEnum):
    """`pending → running → done | failed | cancelled`."""

    PENDING = "pending"
    """No robot has begun a task of it."""
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Nothing follows this state."""
        return self not in (MissionState.PENDING, MissionState.RUNNING)


class StepState(StrEnum):
    """`waiting → open → done | skipped | failed`."""

    WAITING = "waiting"
    """Steps before it have not ended."""
    OPEN = "open"
    DONE = "done"
    SKIPPED = "skipped"
    """It has failed, and the mission continues."""
    FAILED = "failed"


class StepStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A step of a mission."""

    name: Name
    state: StepState = StepState.WAITING
    task: Name = ""
    """Id of its last task; empty if none was made."""
    why: Text = ""
    """Why it has failed, in words."""


class MissionStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A mission that was started."""

    id: Name
    mission: Name
    """Its name among `[[missions]]`."""
    state: MissionState
    at: Names = []
    """Steps that it is at; if it has failed, the step that failed."""
    steps: Annotated[list[StepStatus], Meta(max_length=STEPS_MAX)] = []
    """All of its steps, in order; none in the team's summary."""
    why: Text = ""
    """Why it has failed or was cancelled, in words."""
    by: Text = ""
    """Name of the requester."""
    started_ns: Stamp = 0
    """When it started."""
    ended_ns: Stamp = 0
    """0 if it has not ended."""


MissionList = Annotated[list[MissionStatus], Meta(max_length=1000)]


class MissionStart(msgspec.Struct, frozen=True, kw_only=True):
    """Start a mission. The id makes it idempotent: the same start again has the same effect."""

    id: Name
    mission: Name
    """Its name among `[[missions]]`."""
    parameters: Parameters = {}
    """Values of its parameters; the mission's defaults for those that are not given."""
    by: Text = ""
    """Name of the requester."""


MISSION_START = Query(
    "task/mission/start", "Start a mission: replies its state", MissionStart, MissionStatus, alias="mission_start",
    urgency=Urgency.INTERACTIVE_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
MISSION_CANCEL = Query(
    "task/mission/cancel", "Cancel a mission and its tasks", TaskRequest, MissionStatus, alias="mission_cancel",
    urgency=Urgency.INTERACTIVE_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
MISSION_LIST = Query(
    "task/mission/list", "Open missions, and the last that ended", NoneType, list[MissionStatus], alias="mission_list",
    urgency=Urgency.INTERACTIVE_HIGH, reads_only=True)  # fmt: skip
