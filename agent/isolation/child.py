"""`python -m robrain.agent.isolation.child`: the process of one isolated plugin. Started by ChildProcess."""

import faulthandler
import fcntl
import logging
import os
import resource
import signal
import socket
import sys
import threading
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TextIO, cast

from robrain.agent.class_import import import_class
from robrain.agent.errors import PluginError, PluginHung
from robrain.agent.event import Event, Mailbox
from robrain.agent.hung_thread import traceback_in
from robrain.agent.isolation.child_environment import ChildEnvironment, Parent
from robrain.agent.isolation.contract import Contract, contract_of
from robrain.agent.isolation.messages import (
    OWN,
    WHERE,
    Begin,
    CallRequest,
    Do,
    Get,
    Log,
    Notify,
    ObservedEvent,
    Request,
)
from robrain.agent.isolation.peer import Peer, PeerLost
from robrain.agent.isolation.plain_data import decoder, encode
from robrain.agent.manifest import Manifest, TagTable
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_output import PluginLogs, PluginOutput, PluginStream
from robrain.agent.plugin_traceback import raised
from robrain.protocol.wire.clock import LiveClock

BYTES_PER_MB = 1_000_000


class PluginChild:
    """Holds the real plugin, and does what the parent asks."""

    def __init__(self, name: str, calls: socket.socket, halts: socket.socket, asides: socket.socket) -> None:
        self._name = name
        self._calls = Peer(calls, name, self.serve)
        self._halts = Peer(halts, name, self._halt)
        self._parent = Parent(self._calls, Peer(asides, name, self.serve))
        self._output = PluginOutput(self._log, lambda: name, LiveClock())
        self._turn = threading.RLock()
        self._plugin: Plugin
        self._contract: Contract
        self._env: ChildEnvironment | None = None

    def run(self) -> None:
        """Serve until the parent hangs up."""
        threading.Thread(target=self._halts.run, name="halts", daemon=True).start()
        self._calls.run()
        if self._env is not None:
            self._env.close()

    def serve(self, request: Request) -> bytes:
        """Do what was asked for, in the plugin's turn."""
        with self._turn:
            self._output.report_dropped()
            match request:
                case Begin():
                    self._begin(request)
                case Do(function):
                    if function == "deactivate":
                        self._end_actions("the plugin is deactivated")
                    getattr(self._plugin, function)()
                    return encode(self._plugin.period_s)
                case CallRequest(handle, function, arguments) if handle == OWN:
                    args, kwargs = self._contract.functions[function].read_arguments(arguments)
                    return encode(getattr(self._plugin, function)(*args, **kwargs))
                case Get(handle, attribute) if handle == OWN:
                    return encode(getattr(self._plugin, attribute))
                case ObservedEvent(subscription, value) if self._env is not None:
                    self._env.told(subscription, value)
                case _:
                    raise PluginError(self._name, f"{type(request).__name__} is not for this end")
        return b""

    def _halt(self, request: Request) -> bytes:
        """An emergency halt, or a question where the plugin is: without the turn, which may never end."""
        if request == Do(WHERE):
            stuck = traceback_in(threading.main_thread().ident or 0, type(self._plugin))
            return encode(raised(PluginHung(self._name, "hangs").with_traceback(stuck)))
        self._end_actions("emergency halt")
        self._plugin.emergency_halt()
        return b""

    def _end_actions(self, why: str) -> None:
        if self._env is not None:
            self._env.end_actions(why)

    def _begin(self, begin: Begin) -> None:
        sys.path[:] = begin.import_path
        limit = begin.memory_mb * BYTES_PER_MB
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[PluginLogs(self._output)])
        sys.stdout, sys.stderr = (cast(TextIO, PluginStream(each, self._output)) for each in (sys.stdout, sys.stderr))
        manifest = Manifest(begin.plugin, Path(begin.manifest), begin.class_path, {}, TagTable())
        plugin_class = import_class(manifest)
        self._contract = contract_of(plugin_class)
        self._env = ChildEnvironment(begin, self._parent, self._turn)
        self._env.belongs_to(plugin_class.__module__)
        parameters = decoder(plugin_class.Parameters).decode(begin.parameters)
        self._plugin = plugin_class(self._env, parameters)
        for name in self._contract.events:
            event: Event[Any] = getattr(self._plugin, name)
            event.add(partial(self._notify, name), _Straight())

    def _log(self, _plugin: str, level: str, text: str) -> None:
        with suppress(PeerLost):  # the parent has ended and this process is about to, so nobody reads the log
            self._parent.tell(Log(level, text))

    def _notify(self, name: str, value: Any) -> None:
        self._parent.tell(Notify(name, encode(value)))


class _Straight(Mailbox):
    """Hands on at once: the mailbox that an observer waits at is in the robot's process."""

    def post(self, function: Any, value: Any) -> bool:
        function(value)
        return True


def _end_with_parent(lifeline: int) -> None:
    """Have the kernel end this process when the parent's end of the pipe is closed, whatever Python is at."""
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    try:
        os.read(lifeline, 1)
    except BlockingIOError:
        return
    sys.exit(0)  # it was closed before


def _die_first() -> None:
    """If the machine runs out of memory, this process is to go, not the robot's."""
    Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def main() -> None:
    """Run a plugin; the arguments are its name and four file descriptors."""
    name = sys.argv[1]
    calls, halts, asides, lifeline = (int(argument) for argument in sys.argv[2:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal reaches the parent, which ends this one
    faulthandler.enable()
    _end_with_parent(lifeline)
    _die_first()
    PluginChild(name, *(socket.socket(fileno=number) for number in (calls, halts, asides))).run()
    os._exit(0)  # threads that the plugin has started do not hold up the end


if __name__ == "__main__":
    main()
