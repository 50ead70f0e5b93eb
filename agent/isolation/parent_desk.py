"""What the process of an isolated plugin asks of the robot's: other plugins, events, the board, the log."""

import importlib
import logging
import sys
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginError
from robrain.agent.isolation.contract import Contract
from robrain.agent.isolation.messages import CallRequest, Get, Log, Notify, Observe, ReadBoard, Request, Use, WriteBoard
from robrain.agent.isolation.plain_data import decoder, encode
from robrain.agent.plugin import Plugin
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Pose2D

logger = logging.getLogger(__name__)

Hear = Callable[[int, Any], None]

BOARD_TYPES: dict[str, Any] = {field.name: field.type for field in msgspec.structs.fields(RobotState)} | {
    "T_arena_odom": Pose2D | None,
    "T_odom_robot": Pose2D | None,
    "wheel_ticks": tuple[int, ...] | None,
    "odometry": tuple[tuple[int, Pose2D], ...],
    "published_odometry": tuple[Pose2D, int] | None,
    "wants_odometry": bool,
    "gyro_contradiction": float | None,
    "has_scanned": bool,
    "doubted_scan": list[int] | None,
}
"""The board's facts are those of the state, the frames of dead reckoning, and what devices keep over a restart."""


class _Held(NamedTuple):
    handle: Any
    contract: Contract


class ParentDesk:
    """Answers one process, with the environment and the rights of its plugin.

    Args:
        env: the plugin's.
        plugin: stands for it here, and has its events.
        contract: what it offers.
        own_module: where its class is declared.
        hear: takes a subscription's number and the value of an event that has happened.

    """

    def __init__(
        self, env: Environment, plugin: Plugin, contract: Contract, own_module: str, hear: "weakref.WeakMethod[Hear]"
    ) -> None:
        self._env = env
        self._plugin = weakref.ref(plugin)
        self._contract = contract
        self._own_module = own_module
        self._receive = hear
        self._held: list[_Held] = []

    def serve(self, request: Request) -> bytes:
        """Do what was asked.

        Raises:
            Exception: whatever was raised by whom it concerns.

        """
        match request:
            case CallRequest(number, function, arguments):
                held = self._get(number)
                args, kwargs = held.contract.functions[function].read_arguments(arguments)
                return encode(getattr(held.handle, function)(*args, **kwargs))
            case Get(number, attribute):
                return encode(getattr(self._get(number).handle, attribute))
            case Use(plugin, module, name):
                interface = self._interface(plugin, module, name)
                self._held.append(_Held(self._env.use(plugin, interface), Contract(interface)))
                return encode(len(self._held))
            case Observe(number, event, subscription):
                self._observe(getattr(self._get(number).handle, event), subscription)
            case ReadBoard(name):
                return encode(getattr(self._env.board, name))
            case WriteBoard(name, value):
                self._write_board(name, value)
            case Notify(event, value):
                self._notify(event, value)
            case Log(level, text):
                plugin, number = self._env.plugin, logging.getLevelNamesMapping().get(level.upper(), logging.INFO)
                logging.getLogger(plugin).log(number, text, extra={"plugin": plugin})
            case _:
                raise PluginError(self._env.plugin, f"{type(request).__name__} is not for this end")
        return b""

    def _get(self, number: int) -> _Held:
        return self._held[number - 1]

    def _observe(self, event: Any, subscription: int) -> None:
        hear = self._receive()
        if hear is not None:
            self._env.observe(event, partial(hear, subscription))

    def _notify(self, name: str, written: bytes) -> None:
        plugin = self._plugin()
        if plugin is not None:
            getattr(plugin, name).notify(self._contract.events[name].decode(written))

    def _write_board(self, name: str, written: bytes) -> None:
        try:
            setattr(self._env.board, name, decoder(BOARD_TYPES.get(name, Any)).decode(written))
        except msgspec.ValidationError as error:
            logger.error("%s: on the board, %s: %s", self._env.plugin, name, error)  # noqa: TRY400 - the message says it all, no traceback needed

    def _interface(self, plugin: str, module_name: str, name: str) -> type:
        module_name = module_name or self._own_module
        found: Any = sys.modules.get(module_name)
        try:
            found = found or importlib.import_module(module_name)
            for part in name.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError) as error:
            raise AccessDenied(plugin, f"there is no interface {name} in {module_name}") from error
        if not isinstance(found, type):
            raise AccessDenied(plugin, f"{name} in {module_name} is no interface")
        return found
