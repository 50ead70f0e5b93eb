"""The states of a plugin, the possible transitions of each, and their actions: one table.

Pairs that are not in the table are refused. `ManagedPlugin.apply` is the only code that changes a state.
"""

from collections.abc import Iterable, Mapping
from enum import Enum, auto
from typing import NamedTuple

from robrain.agent.errors import PluginError
from robrain.agent.plugin import PluginState
from robrain.protocol.errors import ErrorCode


class Trigger(Enum):
    """An event in the life of a plugin."""

    INITIALISED = "initialised"
    ACTIVATED = "activated"
    HALT = "halted"
    RESUME = "resumed"
    DEACTIVATE = "deactivated"
    FAIL = "faulted"
    """It raised, hangs or floods; the host cleans up after it in its own step."""
    CLEAN_UP = "cleaned up after"
    """The host handles faulted plugins."""
    LEAVE_OUT = "left out"
    """It cannot be started."""
    ABANDON = "abandoned"
    """A thread is stuck in its instance."""
    RESTART = "restarted"
    """It is to be loaded again."""
    REACTIVATE = "activated again"
    """Its instance is to be activated again."""
    REJECT = "restored"
    """The instance that was to replace another has failed to start."""
    REJECT_STUCK = "restored from one that hangs"
    """A thread is stuck in the instance that was to replace another."""
    UNLOAD = "unloaded"
    CLOSE = "closed"
    """Its host ends."""


class Effect(Enum):
    """A step of a transition; in the order of a row."""

    ASK = auto()
    """Call the plugin's `deactivate`, with its lock; its error is raised, after all other steps."""
    ASK_FAILED = auto()
    """As ASK, of a plugin that has failed already: its error is only logged."""
    RELEASE = auto()
    """Release the plugin's resources: other plugins, leases, observed events, tasks; end its actions."""
    END_ACTIONS = auto()
    """End its actions."""
    END_WIRE = auto()
    """Close the queries and subscriptions of this activation."""
    DISCARD = auto()
    """Close the instance, with all its queries and subscriptions, and have none."""
    LEAVE = auto()
    """Leave the instance, its lock and its thread to the stuck caller."""
    REPORT = auto()
    """Have the host handle the fault."""


class Transition(NamedTuple):
    """The state that follows, and the actions."""

    to: PluginState
    steps: tuple[Effect, ...] = ()


class TransitionRefused(PluginError):
    """The transition of a plugin is not possible in its state; carries `.state` and `.trigger`."""

    code = ErrorCode.REFUSED

    def __init__(self, plugin: str, state: PluginState, trigger: Trigger) -> None:
        super().__init__(plugin, f"{plugin} is {state}: it cannot be {trigger.value}")
        self.state = state
        self.trigger = trigger


_S = PluginState
_END = (Effect.ASK, Effect.RELEASE, Effect.END_WIRE)
_LEAVE = (Effect.LEAVE, Effect.RELEASE, Effect.DISCARD)
_CLEAN_UP = (Effect.ASK_FAILED, Effect.DISCARD)
_RUNNING = (_S.ACTIVE, _S.HALTED)
_NOT_RUNNING = (_S.DISCOVERED, _S.LOADED, _S.INACTIVE, _S.FAULTED)
_LISTED = (*_NOT_RUNNING, *_RUNNING)


def _rows(
    trigger: Trigger, states: Iterable[PluginState], to: PluginState | None, *steps: Effect
) -> dict[tuple[PluginState, Trigger], Transition]:
    """The same transition from several states; each stays as it is if `to` is None."""
    return {(state, trigger): Transition(to or state, steps) for state in states}


TRANSITIONS: Mapping[tuple[PluginState, Trigger], Transition] = {
    **_rows(Trigger.INITIALISED, [_S.DISCOVERED], _S.LOADED),
    **_rows(Trigger.ACTIVATED, [_S.LOADED, _S.INACTIVE], _S.ACTIVE),
    **_rows(Trigger.HALT, [_S.ACTIVE], _S.HALTED),
    **_rows(Trigger.HALT, [*_NOT_RUNNING, _S.HALTED, _S.UNLOADED], None),
    **_rows(Trigger.RESUME, [_S.HALTED], _S.ACTIVE, Effect.END_ACTIONS),  # those that a call began during the halt
    **_rows(Trigger.RESUME, [*_NOT_RUNNING, _S.ACTIVE, _S.UNLOADED], None),
    **_rows(Trigger.DEACTIVATE, _RUNNING, _S.INACTIVE, *_END),
    **_rows(Trigger.DEACTIVATE, [*_NOT_RUNNING, _S.UNLOADED], None),
    **_rows(
        Trigger.FAIL, [_S.DISCOVERED, _S.LOADED, _S.INACTIVE, *_RUNNING], _S.FAULTED, Effect.RELEASE, Effect.REPORT
    ),
    **_rows(Trigger.FAIL, [_S.FAULTED, _S.UNLOADED], None),
    **_rows(Trigger.CLEAN_UP, [_S.FAULTED], _S.FAULTED, *_CLEAN_UP),
    **_rows(Trigger.CLEAN_UP, [_S.UNLOADED], None),
    **_rows(Trigger.LEAVE_OUT, _LISTED, _S.FAULTED, Effect.RELEASE, *_CLEAN_UP),
    **_rows(Trigger.ABANDON, _LISTED, _S.FAULTED, *_LEAVE),
    **_rows(Trigger.ABANDON, [_S.UNLOADED], None),
    **_rows(Trigger.RESTART, [_S.DISCOVERED, _S.INACTIVE, _S.FAULTED], _S.DISCOVERED),
    **_rows(Trigger.REACTIVATE, [_S.LOADED, _S.INACTIVE, _S.FAULTED, _S.DISCOVERED], _S.INACTIVE),
    **_rows(Trigger.REJECT, [_S.INACTIVE, _S.FAULTED, *_RUNNING], _S.INACTIVE, Effect.RELEASE, *_CLEAN_UP),
    **_rows(Trigger.REJECT_STUCK, [_S.INACTIVE, _S.FAULTED, *_RUNNING], _S.INACTIVE, *_LEAVE),
    **_rows(Trigger.UNLOAD, _RUNNING, _S.UNLOADED, Effect.ASK, Effect.RELEASE, Effect.DISCARD),
    **_rows(Trigger.UNLOAD, [_S.LOADED, _S.FAULTED], _S.UNLOADED, Effect.ASK_FAILED, Effect.RELEASE, Effect.DISCARD),
    **_rows(Trigger.UNLOAD, [_S.DISCOVERED, _S.INACTIVE], _S.UNLOADED, Effect.RELEASE, Effect.DISCARD),
    **_rows(Trigger.UNLOAD, [_S.UNLOADED], None),
    **_rows(Trigger.CLOSE, [*_LISTED, _S.UNLOADED], None, Effect.DISCARD),
}


def transition(plugin: str, state: PluginState, trigger: Trigger) -> Transition:
    """The transition of a plugin in a state.

    Raises:
        TransitionRefused: it cannot happen then.

    """
    try:
        return TRANSITIONS[state, trigger]
    except KeyError:
        raise TransitionRefused(plugin, state, trigger) from None
