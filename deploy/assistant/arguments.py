"""Arguments and answers of an assistant's tools: bounded in their types, and checked here once."""

import math
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from robrain.client.submission import COMMON, RELATIVE
from robrain.deploy.assistant.policy import PRIORITY_MAX, Ban, CallRefused
from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name, is_name
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.safe_text import safe_lines, safe_text

ANSWER_MAX = 12_000
"""Longest answer, characters; a model reads every one of them."""
TEXT_MAX = 300
"""Longest text from the team within an answer, and longest list."""
ANSWER_DEPTH_MAX = 8
NOTHING: Mapping[str, object] = MappingProxyType({})


class CallVerdict(StrEnum):
    """Outcome of a call, for the audit log and for programs."""

    READ = "looked"
    REHEARSED = "rehearsed"
    BEGUN = "begun"
    """A confirmed order, before it is carried out."""
    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    """It may have been carried out, but its answer is missing or is an error."""


class ToolAnswer(NamedTuple):
    """One answer."""

    verdict: CallVerdict
    words: str
    values: dict[str, Any]
    png: bytes = b""
    code: str = ""
    """Reason for its refusal."""


def answer(
    verdict: CallVerdict, lines: list[str], values: Mapping[str, object] = NOTHING, *, png: bytes = b"", code: str = ""
) -> ToolAnswer:
    """An answer of bounded size, in which text of the team cannot steer a terminal or hide other text.

    >>> answer(CallVerdict.READ, ["r1 is up"], {"robot": "r1"}).values
    {'robot': 'r1', 'verdict': 'looked'}
    """
    words = cut(safe_lines("\n".join(lines)), ANSWER_MAX)
    plain = {name: harmless(msgspec.to_builtins(value, enc_hook=str)) for name, value in values.items()}
    found = {**plain, **({"code": code} if code else {}), "verdict": str(verdict)}
    if len(msgspec.json.encode(found)) > ANSWER_MAX:  # the words have the beginning of it
        found = {name: value for name, value in found.items() if not isinstance(value, list | dict)}
    return ToolAnswer(verdict, words, found, png, code)


def harmless(value: Any, depth: int = ANSWER_DEPTH_MAX) -> Any:
    """A JSON value with its texts made harmless, and cut where it is long or deep."""
    if isinstance(value, str):
        return safe_text(value, TEXT_MAX)
    if depth <= 0 and isinstance(value, dict | list | tuple):
        return "…"
    if isinstance(value, dict):
        few = list(value.items())[:TEXT_MAX]
        return {safe_text(str(name), TEXT_MAX): harmless(one, depth - 1) for name, one in few}
    if isinstance(value, list | tuple):
        return [harmless(one, depth - 1) for one in value[:TEXT_MAX]]
    return value


BYTES_MAX = 8192
"""Of all arguments of a call as JSON."""
DEPTH_MAX = 8
WORDS_MAX = 300
REASON_MAX = 200
A = TypeVar("A", bound="Arguments")

Name = Annotated[str, Meta(min_length=1, max_length=63, description="Letters, digits, _ - and .")]
Confirm = Annotated[
    str,
    Meta(max_length=64, description="Token of the rehearsal, with otherwise the same arguments; empty to rehearse."),
]
Reason = Annotated[str, Meta(max_length=REASON_MAX, description="Reason, for the record.")]
Metres = Annotated[float, Meta(ge=-10_000.0, le=10_000.0, description="Metres, arena frame.")]
Day = Annotated[float, Meta(ge=0.0, le=86_400.0)]
JsonObject = Annotated[dict[str, Any], Meta(max_length=16)]


class Arguments(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of a tool's arguments; it has no fields."""


class OfRobot(Arguments, frozen=True, kw_only=True):
    """A robot."""

    robot: Name


class OfTask(Arguments, frozen=True, kw_only=True):
    """A task."""

    task: Name


class ListTasks(Arguments, frozen=True, kw_only=True):
    """Which tasks are listed."""

    states: Annotated[list[TaskState], Meta(max_length=8, description="Only these states; any if empty.")] = []
    limit: Annotated[int, Meta(ge=1, le=100, description="At most this many, the last ones.")] = 30


class NewTask(Arguments, frozen=True, kw_only=True):
    """A task that is not submitted."""

    kind: Annotated[str, Meta(min_length=1, max_length=63, description="Kind of task; see list_kinds.")]
    x_m: Metres
    y_m: Metres
    priority: Annotated[float, Meta(gt=0.0, le=PRIORITY_MAX, description="Reward for doing it.")] = PRIORITY_MAX
    earliest_in_s: Annotated[Day | None, Meta(description="Earliest start, seconds from its acceptance.")] = None
    deadline_in_s: Annotated[Day | None, Meta(description="Latest end, seconds from its acceptance.")] = None
    service_s: Annotated[float, Meta(ge=0.0, le=3600.0, description="Seconds at its place.")] = 0.0
    robots: Annotated[int, Meta(ge=1, le=16, description="Robots that work on it at the same time.")] = 1
    needs: Annotated[list[Name], Meta(max_length=8, description="Plugins that its robot must have.")] = []
    after: Annotated[list[Name], Meta(max_length=16, description="Tasks that must be done before.")] = []
    parameters: Annotated[JsonObject, Meta(description="Parameters of its kind; see list_kinds.")] = {}

    @property
    def fields(self) -> dict[str, Any]:
        """As `Team.submit` and `Team.dry_run` take them, besides the kind and the id.

        Raises:
            Refused: a parameter has the name of a field that every task has.

        """
        if smuggled := sorted(self.parameters.keys() & (COMMON | {*RELATIVE, "kind"})):
            raise CallRefused(
                Ban.BAD_ARGUMENTS, f"parameters: {smuggled[0]} is a field of every task, and no parameter"
            )
        given = {
            one.name: value
            for one in msgspec.structs.fields(NewTask)
            if one.name in (*COMMON, *RELATIVE) and (value := getattr(self, one.name)) not in (None, [], 0.0)
        }
        return {**self.parameters, "place": [self.x_m, self.y_m], **given}


class SubmitTask(NewTask, frozen=True, kw_only=True):
    """A task to be submitted."""

    confirm: Confirm = ""


class CancelTask(OfTask, frozen=True, kw_only=True):
    """A task to be cancelled."""

    reason: Reason = ""
    confirm: Confirm = ""


class CallPlugin(OfRobot, frozen=True, kw_only=True):
    """A call of a plugin's function."""

    plugin: Name
    function: Name
    arguments: Annotated[JsonObject, Meta(description="Arguments by name.")] = {}
    confirm: Confirm = ""


class HaltRobots(Arguments, frozen=True, kw_only=True):
    """Robots to halt."""

    robot: Annotated[str, Meta(max_length=63, description="This robot only; the whole team if empty.")] = ""
    reason: Reason = ""


def arguments_of(given: object, type_: type[A]) -> A:
    """A tool's arguments as its type.

    Raises:
        Refused: they are too large, nested too deep, no JSON, or out of their ranges; the words name the argument.

    """
    try:
        written = msgspec.json.encode(given)
    except (TypeError, ValueError, RecursionError) as error:
        raise CallRefused(Ban.BAD_ARGUMENTS, cut(safe_text(str(error)), WORDS_MAX)) from error
    if len(written) > BYTES_MAX:
        raise CallRefused(Ban.BAD_ARGUMENTS, f"expected at most {BYTES_MAX} bytes of JSON, got {len(written)}")
    _check_values(given, "arguments", DEPTH_MAX)
    try:
        found = msgspec.convert(given, type_)
        for field in ("robot", "task", "plugin", "function", "kind"):
            if name := getattr(found, field, ""):
                check_name(field, name)
    except (msgspec.ValidationError, BadName) as error:
        raise CallRefused(Ban.BAD_ARGUMENTS, cut(safe_text(str(error)), WORDS_MAX)) from error
    return found


def halt_arguments(given: object) -> HaltRobots:
    """Robots to halt. No argument prevents a halt: a value that is no robot's name means all robots.

    >>> halt_arguments({"robot": "r1 and r2", "reason": 7})
    HaltRobots(robot='', reason='7')
    """
    found = given if isinstance(given, dict) else {}
    robot, reason = found.get("robot", ""), found.get("reason", "")
    is_one = isinstance(robot, str) and is_name(robot)
    return HaltRobots(robot=robot if is_one else "", reason=safe_text(str(reason), REASON_MAX))


def order_text(tool: str, arguments: Arguments) -> bytes:
    """A tool and its arguments without the token, in one canonical form."""
    fields = {name: value for name, value in msgspec.to_builtins(arguments).items() if name != "confirm"}
    return msgspec.json.encode([tool, fields], order="deterministic")


def _check_values(value: object, where: str, depth: int) -> None:
    if depth < 0:
        raise CallRefused(Ban.BAD_ARGUMENTS, f"nested deeper than {DEPTH_MAX}")
    if isinstance(value, str) and safe_text(value) != value:
        raise CallRefused(Ban.BAD_ARGUMENTS, f"{where}: expected text without control or invisible characters")
    if isinstance(value, float) and not math.isfinite(value):
        raise CallRefused(Ban.BAD_ARGUMENTS, f"{where}: expected a finite number, got {value}")
    if isinstance(value, dict):
        for name, one in value.items():
            _check_values(name, "a name of an argument", depth - 1)
            _check_values(one, cut(str(name), 63), depth - 1)
    elif isinstance(value, list | tuple):
        for one in value:
            _check_values(one, where, depth - 1)
