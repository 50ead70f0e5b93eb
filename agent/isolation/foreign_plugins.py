"""Foreign plugins: separate processes, in any language, that announce themselves to a robot.

Such a process declares the liveliness token `robot/R/foreign/NAME`, answers `…/info` with a PluginInfo, and answers
`…/call/FUNCTION`. It does not answer under the robot's `call/` keys itself. The host answers those for all plugins, its
own and the foreign ones, whose calls it relays. Thus there is one answer, and one place that checks the caller's
rights.
"""

import inspect
import logging
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, TypeVar, cast, get_type_hints

import msgspec

from robrain.agent.errors import AccessDenied, PluginInactive, PluginMissing, PluginUnloaded
from robrain.agent.isolation.contract import Contract
from robrain.agent.manifest import ANYBODY, COMMAND
from robrain.agent.plugin import Level
from robrain.agent.text_form import parse_argument, print_value
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import (
    ROBOT_FOREIGN,
    ROBOT_FOREIGN_CALL,
    ROBOT_FOREIGN_INFO,
    PluginInfo,
)
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

InterfaceT = TypeVar("InterfaceT")

CALL_TIMEOUT_S = 2.0
RETRY_NS = to_ns(0.5)
"""A plugin that has announced itself without a description is asked again after this."""
REFRESH_NS = to_ns(10.0)
"""Period of queries for its description, in case another one has replaced it unnoticed."""


class ForeignPlugins:
    """Tracks and calls the foreign plugins of one robot, in the live drive.

    Args:
        wire: the host's endpoint; closing it also stops the tracking.
        robot: the robot's name.
        is_halted: whether the robot is halted; no plugin is called then.

    """

    def __init__(self, wire: Endpoint, robot: str, is_halted: Callable[[], bool] = lambda: False) -> None:
        self._is_halted = is_halted
        self._wire = wire
        self._robot = robot
        self._inbox = Inbox()
        self._presence = wire.watch(ROBOT_FOREIGN, robot=robot)
        self._due_ns: dict[str, int] = {}
        self._infos: dict[str, PluginInfo] = {}  # replaced, never changed: other threads read it

    def follow(self) -> list[str]:
        """Check which plugins have appeared or gone; the host calls this in its step. Returns the new names."""
        came: list[str] = []
        now_ns = self._wire.clock.now_ns()
        infos = dict(self._infos)
        for change in self._presence.changes():
            name = change.names["plugin"]
            if change.present:
                self._due_ns[name] = now_ns
            else:
                self._due_ns.pop(name, None)
                if infos.pop(name, None) is not None:
                    logger.warning("%s: foreign plugin %s has gone", self._robot, name)
        for received in self._inbox.drain():
            name = received.names["plugin"]
            info = self._read(name, received.message)
            if name in self._due_ns and info is not None:
                if name not in infos:
                    logger.info("%s: foreign plugin %s is here", self._robot, name)
                    came.append(name)
                infos[name] = info
                self._due_ns[name] = now_ns + REFRESH_NS
        self._infos = infos
        for name, due_ns in self._due_ns.items():
            if now_ns >= due_ns:
                self._due_ns[name] = now_ns + RETRY_NS
                self._wire.ask_into(self._inbox, ROBOT_FOREIGN_INFO, ROBOT_FOREIGN_INFO, robot=self._robot, plugin=name)
        return came

    def infos(self) -> list[PluginInfo]:
        """The present plugins, ordered by name."""
        return [info for _, info in sorted(self._infos.items())]

    def __contains__(self, name: str) -> bool:
        return name in self._infos

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._infos))

    def relay(self, name: str, function: str, payload: bytes = b"", *, caller: str = COMMAND) -> bytes:
        """Call a function with arguments in JSON, and return the result in JSON.

        Args:
            name: the foreign plugin.
            function: one that it has announced.
            payload: an array of arguments by position, an object by name, or nothing.
            caller: the plugin that calls; `command` for the outside.

        Raises:
            CallError: the caller has no right, there is no such plugin or function, or the plugin has answered with it.

        """
        info = self._infos.get(name)
        if info is None:
            raise CallError(ErrorCode.UNKNOWN_PLUGIN, f"no foreign plugin {name}")
        if self._is_halted():
            raise CallError(ErrorCode.HALTED, f"{name} is not called while the robot is halted")
        if not _may_use(caller, info):
            who = "the outside" if caller == COMMAND else caller
            raise CallError(ErrorCode.FORBIDDEN, f"{name} is not open to {who}")
        if function not in (known := [each.name for each in info.functions]):
            names = ", ".join(known) or "none"
            raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{name} has no function {function}; it has: {names}")
        try:
            reply = self._wire.ask(
                ROBOT_FOREIGN_CALL,
                payload or None,
                timeout_s=CALL_TIMEOUT_S,
                robot=self._robot,
                plugin=name,
                function=function,
            )
        except NobodyThere as error:
            raise CallError(ErrorCode.UNLOADED, f"{name} has gone") from error
        try:
            msgspec.json.decode(reply, type=msgspec.Raw)
        except msgspec.DecodeError as error:
            raise CallError(ErrorCode.FAILED, f"{name} has not answered in JSON: {error}") from error
        return reply

    def call_text(self, name: str, function: str, words: list[str]) -> str:
        """The same for the outside with arguments as text, each `VALUE` or `NAME=VALUE`; the result as text."""
        known = next((each for each in self._infos[name].functions if each.name == function), None)
        properties = known.parameters.get("properties", {}) if known is not None else {}
        free = [each for each in properties if not any(parse_argument(word)[0] == each for word in words)]
        arguments: dict[str, Any] = {}
        for word in words:
            parameter, text = parse_argument(word)
            if parameter is None:
                if not free:
                    most = f"{function} takes at most {len(properties)} arguments, got {len(words)}"
                    raise CallError(ErrorCode.BAD_ARGUMENTS, most)
                parameter = free.pop(0)
            arguments[parameter] = _value_of(text, properties.get(parameter, {}))
        result = msgspec.json.decode(self.relay(name, function, msgspec.json.encode(arguments)))
        return "" if result is None else print_value(result)

    def use(self, caller: str, level: Level, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """A handle for a plugin of the robot; made for a caller whose name and level are known.

        Raises:
            PluginMissing: there is no such foreign plugin now.
            AccessDenied: the level, the visibility or the interface speaks against it.

        """
        info = self._infos.get(name)
        if info is None:
            raise PluginMissing(
                name, f"no foreign plugin {name}; there are: {', '.join(sorted(self._infos)) or 'none'}"
            )
        if Level[info.level.upper()] >= level:
            raise AccessDenied(
                name,
                f"{caller} ({level.name.lower()}) may not call {name} ({info.level}): calls go to lower levels only",
            )
        if not _may_use(caller, info):
            raise AccessDenied(name, f"{caller} is not in the visibility of {name}")
        contract = Contract(interface)
        missing = sorted(contract.functions.keys() - {function.name for function in info.functions})
        if missing or contract.events:
            what = ", ".join(missing) or "events"
            raise AccessDenied(name, f"{name} offers no {what}, which {interface.__name__} wants")
        calls = {
            function: _over_the_wire(self, caller, name, function, getattr(interface, function))
            for function in contract.functions
        }
        return cast(InterfaceT, SimpleNamespace(**calls))

    def _read(self, name: str, info: PluginInfo) -> PluginInfo | None:
        if info.level.upper() not in Level.__members__:
            levels = ", ".join(level.name.lower() for level in Level)
            reason = f"expected level {levels}, got {info.level!r}"
            logger.warning("%s: foreign plugin %s is not listed: %s", self._robot, name, reason)
            return None
        # Under the name of its key alone; the host adds holders and the like.
        return PluginInfo(
            name=name,
            level=info.level.lower(),
            state="active",
            visibility=info.visibility,
            period_s=info.period_s,
            doc=info.doc,
            functions=info.functions,
        )


def _over_the_wire(
    plugins: ForeignPlugins, caller: str, name: str, function: str, declared: Callable[..., Any]
) -> Callable[..., Any]:
    returned = get_type_hints(declared).get("return", Any)
    signature = inspect.signature(declared)

    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(None, *args, **kwargs).arguments  # the None stands for `self`
        arguments = list(given.items())[1:]
        try:
            reply = plugins.relay(name, function, msgspec.json.encode(dict(arguments)), caller=caller)
        except CallError as error:  # errors that are no fault of the caller's, as with a plugin of the robot's own
            if error.code is ErrorCode.HALTED:
                raise PluginInactive(name, error.message) from error
            if error.code in (ErrorCode.UNLOADED, ErrorCode.UNKNOWN_PLUGIN):
                raise PluginUnloaded(name, f"{name} has gone") from error
            raise
        try:
            return msgspec.json.decode(reply, type=returned)
        except msgspec.ValidationError as error:
            raise CallError(ErrorCode.FAILED, f"{name}.{function} has returned something else: {error}") from error

    return call


def _value_of(text: str, schema: dict[str, Any]) -> Any:
    """The value of a word of the text form; the foreign plugin itself checks whether it fits."""
    try:
        value = msgspec.json.decode(text)
    except msgspec.DecodeError:
        return text
    return text if schema.get("type") == "string" and not isinstance(value, str) else value


def _may_use(caller: str, info: PluginInfo) -> bool:
    return caller in info.visibility or (ANYBODY in info.visibility and caller != COMMAND)
