"""The verbs of a robot's host, `robot/R/host/VERB`: a registry of them, and their functions.

A distribution adds a verb by an entry point in the group `robrain.host_verbs`:

    BLINK = host_query("blink", BlinkRequest, int, "Blink the lamp: replies how often")
    blink = HostVerb(BLINK, lambda host, request: lamp.blink(request.asked.times))
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol

from robrain.agent.errors import ManifestError, PluginError
from robrain.agent.host.command_door import TextCommandDoor
from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.host.robot_halts import RobotHalts
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.plugin_traceback import log_error, raised
from robrain.protocol.access.signing import vouch_request
from robrain.protocol.errors import BadName, CallError, ErrorCode
from robrain.protocol.messages.robots import host_messages as rows
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.registry import Registry, UnknownEntry
from robrain.protocol.table.topics import HOST_VERB
from robrain.protocol.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Endpoint, Request

logger = logging.getLogger(__name__)

Infos = list[PluginInfo]


class VerbHost(Protocol):
    """The part of a robot's host that a verb may use."""

    name: str
    manager: PluginManager
    halting: RobotHalts
    door: TextCommandDoor

    @property
    def loadable(self) -> Sequence[Path]:
        """Folders from which plugins may be loaded by path."""

    def info(self, plugin: ManagedPlugin) -> PluginInfo:
        """A plugin as the host reports it."""


@dataclass(frozen=True)
class HostVerb(Generic[Q, R]):
    """A verb of the host.

    It runs on one of several threads, so verbs may run in parallel.
    """

    query: Query[Q, R]
    """Its row, with the types of request and reply; made by `host_query`."""
    run: Callable[[VerbHost, Request[Q]], R]
    """Does it. A PluginError or CallError refuses it in words; anything else is logged, and answered `failed`."""

    @property
    def name(self) -> str:
        """The last chunk of its key."""
        return self.query.chunks[-1]


def answer_verb(host: VerbHost, wire: Endpoint, request: Request[bytes]) -> bytes:
    """Run the verb in a query's key; the reply, encoded.

    Raises:
        CallError: it is unknown (counted as a refused message) or refused, or its request does not match its row.

    """
    name = request.names["verb"]
    key = HOST_VERB.key(wire.team, robot=host.name, verb=name)
    try:
        HOST_VERBS.check(name)
    except UnknownEntry as error:
        wire.refusals.record(HOST_VERB.name, key, RefusalCode.MALFORMED, str(error))
        raise CallError(ErrorCode.UNKNOWN_FUNCTION, str(error)) from error
    verb = _imported(name)
    asked = wire.read_request(verb.query, key, request.asked)
    if request.asker is not None:
        asked = vouch_request(verb.query, key, asked, request.asker, wire.refusals)
    try:
        result = verb.run(host, Request(request.names, asked, request.by, asker=request.asker))
    except PluginError as error:
        code = ErrorCode.REFUSED if error.code is ErrorCode.FAILED else error.code
        detail = raised(error).detail
        if detail:
            log_error(logger, f"{host.name}: {name} {error.plugin}", error)
        raise CallError(code, str(error), getattr(error, "holder", "") or detail) from error
    return verb.query.payloads.write(result)


def _imported(name: str) -> "HostVerb[Any, Any]":
    try:
        verb: object = HOST_VERBS.get(name)
    except UnknownEntry as error:
        raise CallError(ErrorCode.FAILED, str(error)) from error
    if not isinstance(verb, HostVerb) or verb.query.pattern != HOST_VERB.pattern.replace("{verb}", name):
        raise CallError(ErrorCode.FAILED, f"the entry point {name} of {HOST_VERBS.group} is no HostVerb of that name")
    return verb


def _load(host: VerbHost, request: Request[rows.LoadRequest]) -> Infos:
    try:
        return [host.info(plugin) for plugin in host.manager.load(request.asked.plugin, host.loadable)]
    except ManifestError as error:
        raise error.for_outside() from error


def _unload(host: VerbHost, request: Request[rows.UnloadRequest]) -> Infos:
    asked = request.asked
    return [host.info(plugin) for plugin in host.manager.unload(asked.plugin, cascade=asked.cascade)]


def _hold(host: VerbHost, request: Request[rows.HoldRequest]) -> rows.Lease:
    asked = request.asked
    try:
        return host.manager.get(asked.plugin).hold(asked.by, asked.lease_s)
    except BadName as error:
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"hold: {error}") from error


LOAD = HostVerb(rows.HOST_LOAD, _load)
UNLOAD = HostVerb(rows.HOST_UNLOAD, _unload)
RELOAD = HostVerb(rows.HOST_RELOAD, lambda host, request: [host.info(host.manager.reload(request.asked.plugin))])
COMMAND = HostVerb(
    rows.HOST_COMMAND, lambda host, request: host.door.call_text(request.asked.text, by=request.asked.by or request.by)
)
HOLD = HostVerb(rows.HOST_HOLD, _hold)
RELEASE = HostVerb(
    rows.HOST_RELEASE,
    lambda host, request: host.manager.get(request.asked.plugin).exclusive.end_lease(request.asked.by),
)
HALT = HostVerb(
    rows.HOST_HALT, lambda host, request: host.halting.halt(request.asked.by or request.by, request.asked.reason)
)
RESUME = HostVerb(rows.HOST_RESUME, lambda host, request: host.halting.resume(request.asked.by or request.by))
AT_ONCE = (HALT.name, RESUME.name)
"""Answered even when all threads are busy."""
HOST_VERBS: Registry[HostVerb[Any, Any]] = Registry(
    "host verb",
    "robrain.host_verbs",
    {name.lower(): f"{__name__}:{name}" for name, verb in list(globals().items()) if isinstance(verb, HostVerb)},
)
"""The verbs by name."""
