"""The base of plugins: four lifecycle functions, a level, and a step if the plugin is active.

class Blinker(Unit):
    period_s = 0.5

    def step(self) -> None:
        ...

    @external
    def hello(self, name: str = "world") -> str:
        return f"hello {name}"
"""

import re
from collections.abc import Callable
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, overload

import msgspec

if TYPE_CHECKING:
    from robrain.agent.environment import Environment

Function = TypeVar("Function", bound=Callable[..., Any])

EXTERNAL_MARK = "__robrain_external__"
"""Holds the external name of a function."""
UNLOCKED_MARK = "__robrain_unlocked__"
_EXTERNAL_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Level(IntEnum):
    """The hierarchy: calls go to strictly lower levels."""

    DEVICE = 0
    UNIT = 1
    SKILL = 2
    BEHAVIOR = 3


class PluginState(StrEnum):
    """`discovered → loaded → active`; `inactive`, `faulted` and `halted` come with why; `unloaded` is the end."""

    DISCOVERED = "discovered"
    LOADED = "loaded"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FAULTED = "faulted"
    HALTED = "halted"
    UNLOADED = "unloaded"

    @property
    def is_running(self) -> bool:
        """Whether the plugin has been activated and not ended since; a halted plugin runs, but takes no calls."""
        return self in (PluginState.ACTIVE, PluginState.HALTED)


class NoParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of a plugin that has none."""


class Plugin:
    """Base of all plugins; derive from Device, Unit, Skill or Behavior.

    A plugin is active if it has a `period_s`: the host then calls `step()` that often. All functions of one
    plugin, `step` included, are called one at a time.
    """

    level: ClassVar[Level]
    interface: ClassVar[type | None] = None
    """Protocol of the functions that other plugins may call; None if there are none."""
    Parameters: ClassVar[type[msgspec.Struct]] = NoParameters
    """Type of the manifest's [parameters]."""
    period_s: float | None = None
    parameters: Any

    def __init__(self, env: "Environment", parameters: Any) -> None:
        self.env = env
        self.parameters = parameters

    def init(self) -> None:
        """Set up all that needs no other plugin."""

    def activate(self) -> None:
        """Get hold of the plugins that are required, and start."""

    def step(self) -> None:
        """Do one period's work."""

    def deactivate(self) -> None:
        """Stop, and release everything that `activate` took."""

    def emergency_halt(self) -> None:
        """Stop all motion, at once. May be called at any time, from another thread, without the plugin's lock."""


class Device(Plugin):
    """Drives one piece of hardware."""

    level = Level.DEVICE


class Unit(Plugin):
    """Makes more of Devices."""

    level = Level.UNIT


class Skill(Plugin):
    """Knows how to do something, with Units or without any hardware."""

    level = Level.SKILL


class Behavior(Plugin):
    """The robot's visible behavior."""

    level = Level.BEHAVIOR
    kind: ClassVar[str] = ""
    """The kind of task that it does, as the robot announces it to the team; empty if it does none."""
    task_parameters: ClassVar[type[msgspec.Struct]] = NoParameters
    """Type of the tasks' parameters; its JSON Schema is announced as well."""


@overload
def external(function: Function, /) -> Function: ...
@overload
def external(name: str, /) -> Callable[[Function], Function]: ...
def external(marked: Any, /) -> Any:
    """Open a method to callers outside the robot; its type hints are the signature.

    `@external` opens it under its own name, `@external("foo")` as `foo`. Several methods may share an external name
    if their signatures differ.

    Raises:
        ValueError: the name cannot be called from outside.

    """
    if isinstance(marked, str):
        return lambda function: _opened(function, marked)
    return _opened(marked, marked.__name__)


def unlocked(function: Function) -> Function:
    """Have a function called without the plugin's lock: it calls upwards, or only reads values that one step writes."""
    setattr(function, UNLOCKED_MARK, True)
    return function


def _opened(function: Function, name: str) -> Function:
    if not _EXTERNAL_NAME.fullmatch(name):
        raise ValueError(f"external name {name!r}: expected ASCII letters, digits and _, not starting with a digit")
    setattr(function, EXTERNAL_MARK, name)
    return function
