"""A fault script: a team, its tasks and halts, and its faults. The unit of a soak."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.coordinator.planning.policy import NEAREST
from robrain.protocol.errors import RobrainError
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Name
from robrain.protocol.model.tasks.task import Task
from robrain.sim.faults.fault_spec import COORDINATOR, HARDWARE, FaultKind, FaultSpec

Time = Annotated[float, Meta(ge=0.0, le=86_400.0)]


class ScriptError(RobrainError):
    """A file is no fault script; the text names file and key."""


class ScriptRobot(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot of the team."""

    name: Name
    place: Point2D
    soc: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0


class TaskInput(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A task that the operator submits, until the coordinator acknowledges it."""

    at_s: Time
    task: Task


class CancelOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A task that the operator cancels once it is acknowledged."""

    at_s: Time
    task: Name


class HaltOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A halt of the team, and its end."""

    at_s: Time
    until_s: Time

    def __post_init__(self) -> None:
        if not self.until_s > self.at_s:
            raise ValueError(f"expected until_s > at_s = {self.at_s:g}, got {self.until_s}")


class ScriptRadio(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The radio between the components of a script: the keys of `[links]` with these names."""

    range_m: Annotated[float, Meta(gt=0.0, le=1000.0)]
    loss: Annotated[float, Meta(ge=0.0, le=0.95)]
    delay_s: Annotated[float, Meta(ge=0.0, le=10.0)]


class FaultScript(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run. Raises ValueError for values that do not fit."""

    seed: int
    """Draws losses of the wire, and the times of faults that leave them open."""
    robots: Annotated[tuple[ScriptRobot, ...], Meta(min_length=1, max_length=100)]
    scenario: Annotated[str, Meta(max_length=100)] = ""
    """A scenario that is shipped, in which it is run with the full stack; empty for points in a hall."""
    chargers: tuple[Point2D, ...] = ()
    method: Name = NEAREST
    """Allocator of the coordinator's plans, or `nearest`."""
    consensus: bool = False
    """Whether the robots continue without a coordinator."""
    is_divided: bool = False
    """Whether walls with doors for one robot divide the hall of points."""
    tasks: tuple[TaskInput, ...] = ()
    cancels: tuple[CancelOrder, ...] = ()
    halts: tuple[HaltOrder, ...] = ()
    faults: tuple[FaultSpec, ...] = ()
    radio: ScriptRadio | None = None
    """The radio between robots and coordinator; None if it is perfect. With `scenario` only."""

    def __post_init__(self) -> None:
        names = [robot.name for robot in self.robots]
        if self.radio is not None and not self.scenario:
            raise ValueError("expected no radio without a scenario: only the full stack has one")
        for fault in self.faults:
            if fault.robot not in (*names, COORDINATOR):
                raise ValueError(f"expected one of {', '.join(names)} or {COORDINATOR}, got robot = {fault.robot!r}")
            if fault.kind in HARDWARE and not self.scenario:
                raise ValueError(f"expected no hardware fault, got {fault.kind}: robots are points")
            if fault.kind is FaultKind.KILL and fault.robot == COORDINATOR and fault.until_s is None:
                raise ValueError("expected until_s for kill of the coordinator: nobody else would do the tasks")

    @property
    def faults_end_s(self) -> float:
        """Time of the last order or fault, of those at set times."""
        times = [0.0, *(order.at_s for order in self.tasks), *(order.at_s for order in self.cancels)]
        times += [halt.until_s for halt in self.halts]
        for fault in self.faults:
            times.append((fault.at_s if fault.until_s is None else fault.until_s) + fault.within_s)
        return max(times)


def read_script(path: Path) -> FaultScript:
    """Read a script from its JSON file.

    Raises:
        ScriptError: naming file, key and expected value.

    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=FaultScript)
    except OSError as error:
        raise ScriptError(f"{path}: cannot be read: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        what, _, where = str(error).partition(" - at `$")
        key = where.rstrip("`").lstrip(".") or "file"
        raise ScriptError(f"{path}: {key}: {what}") from error


def script_json(script: FaultScript) -> bytes:
    """The text of a script's file."""
    return msgspec.json.format(msgspec.json.encode(script), indent=2) + b"\n"
