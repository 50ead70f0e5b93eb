"""Calls that enter a plugin from outside its own step: external calls, tasks, queries; each takes the plugin's lock."""

import logging
from collections.abc import Callable
from typing import Any

from robrain.agent.access.callee import Callee
from robrain.agent.access.external_function import ExternalFunction, find_function
from robrain.agent.environment import Environment
from robrain.agent.errors import FOREIGN_ERRORS, PluginBusy, PluginError
from robrain.agent.manifest import COMMAND
from robrain.agent.plugin import Plugin, PluginState
from robrain.agent.plugin_traceback import log_error
from robrain.agent.task_desk import Accept, LetGo, TaskWork
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons.offers import PluginOut
from robrain.protocol.wire.endpoint import Handler, Request

logger = logging.getLogger(__name__)


def external_function(callee: Callee, function: str, by: str) -> ExternalFunction:
    """An external function that somebody outside may call now.

    Args:
        callee: whose function it is.
        function: its external name, or that of one signature.
        by: who calls; only that one may call a plugin that it holds.

    Raises:
        CallError: with the code that says why not.

    """
    if COMMAND not in callee.manifest.tag.visibility:
        raise CallError(ErrorCode.FORBIDDEN, f"{callee.name} is not open to the outside")
    functions = callee.functions
    if functions is None:
        raise CallError(ErrorCode.INACTIVE, f"{callee.name} is {callee.state}: {callee.why}")
    known = find_function(functions, function)
    if known is None:
        names = ", ".join(functions) or "none"
        raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{callee.name} has no function {function}; it has: {names}")
    if callee.state is PluginState.HALTED:
        raise CallError(ErrorCode.HALTED, f"{callee.name} is halted")
    if not callee.manifest.tag.shared:
        holder = callee.exclusive.rival_of(by)
        if holder:
            raise CallError(ErrorCode.BUSY, str(PluginBusy(callee.name, holder)), holder)
    return known


def call_from_outside(callee: Callee, known: ExternalFunction, call: Callable[[Plugin], Any]) -> Any:
    """Call a plugin that is live, in its turn unless the function needs none (CallError if it refuses)."""
    try:
        if known.unlocked:
            return call(callee.live_plugin())
        with callee.turn:
            return call(callee.live_plugin())
    except CallError:
        raise
    except PluginError as error:
        raise CallError(error.code, str(error), getattr(error, "holder", "")) from error
    except FOREIGN_ERRORS as error:  # foreign plugin code; the caller and the log both get its traceback
        kind = type(error).__name__
        detail = log_error(logger, f"plugin {callee.name}: {known.name} failed: {kind}", error)
        raise CallError(ErrorCode.FAILED, f"{kind}: {error}", detail) from error


def task_handlers(plugin: Callee, accept: Accept, let_go: LetGo, work: TaskWork) -> tuple[Accept, LetGo, TaskWork]:
    """The same three, called with the plugin's lock held.

    `accept` is called only while the plugin is active; what `accept` or `let_go` raises is a fault of the plugin.
    """

    def accept_in_turn(task: Task) -> TaskAnswer:
        try:
            with plugin.turn:
                if plugin.state is not PluginState.ACTIVE:
                    return TaskAnswer.refused(PluginOut(plugin.name, plugin.state))
                return accept(task)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            plugin.blame(error)
            return TaskAnswer.refused(PluginOut(plugin.name, plugin.state, cut(plugin.why or str(error))))

    def release_in_turn(why: str) -> None:
        try:
            with plugin.turn:
                let_go(why)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            plugin.blame(error)

    def work_in_turn(task: Task) -> Work:
        with plugin.turn:
            return work(task)

    return accept_in_turn, release_in_turn, work_in_turn


def query_handler(plugin: Callee, environment: Environment, handler: Handler[Any, Any]) -> Handler[Any, Any]:
    """The same handler, called with the plugin's lock held and only while this instance is there."""

    def answer(request: Request[Any]) -> Any:
        try:
            with plugin.turn:
                if not plugin.holds(environment) or plugin.state not in (PluginState.ACTIVE, PluginState.HALTED):
                    raise CallError(ErrorCode.INACTIVE, f"{plugin.name} is {plugin.state}: {plugin.why}")
                return handler(request)
        except PluginError as error:
            raise CallError(error.code, str(error)) from error

    return answer
