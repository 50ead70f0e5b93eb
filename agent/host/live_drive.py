"""The live drive of one robot: a few threads that its plugins share, and the host's loop.

Emergency halts arrive on a separate thread; see `robrain.agent.host.robot_halts`.
"""

import math
import sys
import threading
import time
from collections.abc import Callable
from functools import partial

from robrain.agent.errors import FOREIGN_ERRORS, PluginError
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.turn import PluginLock
from robrain.protocol.workers import OwnedThread, close_threads

HOST_PERIOD_S = 0.02
SPARE = 2
"""Threads that wait for a turn, at most; more than one, so that a short rush starts no threads."""
JOIN_TIMEOUT_S = 2.0
SWITCH_INTERVAL_S = 0.0002
"""How long a thread that is busy in Python may keep the others waiting: a halt passes through several of them."""


class DrivenPlugin:
    """One plugin as the threads see it.

    Args:
        plugin: the plugin, with the lock that it has now.

    """

    def __init__(self, plugin: ManagedPlugin) -> None:
        self.plugin = plugin
        self.due_s = 0.0
        """When its next turn is due, by the wall; infinite for a passive plugin."""
        self.is_wanted = True
        """Whether its turn is due at once: something waits for it."""
        self.is_busy = False
        """Whether a thread is in it."""
        self.has_gone = False
        self._step_due_s = 0.0
        self._was_passive = True

    def turn(self) -> None:
        """Deliver the plugin's waiting notifications, then its own step if that is due."""
        plugin = self.plugin
        mailbox = plugin.mailbox
        if mailbox and not self.has_gone:
            plugin.run(steps=False)
        period_s = plugin.period_s
        if period_s is not None and not 0.0 < period_s < math.inf:
            raise PluginError(plugin.name, f"expected period_s above 0, or None, got {period_s!r}")
        now_s = time.monotonic()
        if self._was_passive or mailbox.is_hurried:  # or was not there: no step was missed
            mailbox.is_hurried = False
            self._step_due_s = now_s
        self._was_passive = period_s is None
        if period_s is not None and now_s >= self._step_due_s and not self.has_gone:
            plugin.run(steps=True)
            self._step_due_s += period_s
            now_s = time.monotonic()
            if now_s > self._step_due_s:  # the step took longer than its period: missed steps are not caught up
                plugin.overruns += 1
                self._step_due_s = now_s
        self.due_s = math.inf if period_s is None else self._step_due_s


class PluginThreads:
    """Gives all plugins their turns, on as few threads as are busy at a time and one or two that wait.

    No plugin waits for another: before a thread enters a plugin, it ensures that another thread waits for the next due
    turn. So another replaces one that is stuck in a plugin. There are at most as many threads as plugins that are in a
    turn, those included that hang and were abandoned, and `SPARE` more.

    Args:
        host: its plugins are followed as they are loaded and unloaded while the robot runs.

    """

    def __init__(self, host: AgentHost) -> None:
        self._host = host
        self._members: dict[PluginLock, DrivenPlugin] = {}
        """By the plugin's lock: one that is abandoned with a stuck caller gets another."""
        self._changed = threading.Condition()
        self._threads: list[OwnedThread] = []
        self._alive = 0
        self._entered: list[DrivenPlugin] = []
        """Plugins in which a thread may be."""
        self._watches: list[float] = []
        """Times at which waiting threads wake by themselves; the others sleep until they are notified."""
        self._stopping = False

    def follow(self) -> None:
        """Add new plugins, release those that have gone."""
        wanted = {plugin.turn: plugin for plugin in self._host.manager.plugins.values()}
        if wanted.keys() == self._members.keys():
            return
        with self._changed:
            for key in [key for key in self._members if key not in wanted]:
                self._members.pop(key).has_gone = True
            for key, plugin in wanted.items():
                if key not in self._members:
                    member = self._members[key] = DrivenPlugin(plugin)
                    plugin.mailbox.wake = partial(self._want, member)
            if self._free():
                self._changed.notify_all()
            else:
                self._begin()

    def stop(self) -> None:
        """End all, and wait for them; a step that hangs is abandoned (the thread is a daemon)."""
        with self._changed:
            self._stopping = True
            for member in self._members.values():
                member.has_gone = True
                member.plugin.mailbox.wake = None
            self._members.clear()
            self._changed.notify_all()
        close_threads(self._threads, JOIN_TIMEOUT_S)

    def _want(self, member: DrivenPlugin) -> None:
        if member.is_wanted:
            return  # the thread that serves it next handles this as well
        with self._changed:
            member.is_wanted = True
            if not member.is_busy:
                self._changed.notify()

    def _free(self) -> int:
        """Number of threads that are in no plugin: they wait for a turn, or are about to."""
        self._entered = [member for member in self._entered if member.is_busy]
        return self._alive - len(self._entered)

    def _begin(self) -> None:
        thread = OwnedThread("plugin-thread", self._run)
        self._alive += 1
        self._threads = [*(each for each in self._threads if each.is_alive), thread]

    def _run(self) -> None:
        thread = threading.current_thread()
        own_name = thread.name
        while (member := self._wait_for_turn()) is not None:
            thread.name = f"plugin-{member.plugin.name}"
            try:
                member.turn()
            except FOREIGN_ERRORS as error:  # a plugin's own description is foreign too
                member.plugin.fault(error)
            finally:
                thread.name = own_name
                member.is_busy = False

    def _wait_for_turn(self) -> DrivenPlugin | None:
        """Wait for a plugin whose turn is due; None if this thread is to end."""
        with self._changed:
            if self._free() > SPARE:
                self._alive -= 1
                self._changed.notify()  # the plugin that this thread was in may be the next one
                return None
            member = self._next()
            while not self._stopping and not (member and (member.is_wanted or member.due_s <= time.monotonic())):
                self._wait(math.inf if member is None else member.due_s)
                member = self._next()
            if self._stopping or member is None:
                return None
            member.is_wanted, member.is_busy = False, True
            self._entered.append(member)
            following = self._next()
            if not self._free():
                self._begin()
            elif following is not None and (following.is_wanted or following.due_s < self._watched_s()):
                self._changed.notify()
            return member

    def _wait(self, until_s: float) -> None:
        """Wait for a change; also for a time, unless another thread wakes by then."""
        if self._watched_s() <= until_s:
            self._changed.wait()
            return
        self._watches.append(until_s)
        self._changed.wait(max(until_s - time.monotonic(), 0.0))
        self._watches.remove(until_s)

    def _watched_s(self) -> float:
        return min(self._watches, default=math.inf)

    def _next(self) -> DrivenPlugin | None:
        """The plugin whose turn is due first, among those without a thread in them."""
        first, first_s = None, math.inf
        for member in self._members.values():
            if member.is_busy:
                continue
            if member.is_wanted:
                return member
            if member.due_s < first_s:
                first, first_s = member, member.due_s
        return first


def run_agent(host: AgentHost, should_stop: Callable[[], bool], on_ready: Callable[[], None]) -> None:
    """Start a robot and run it until `should_stop()`; everything is closed when this returns.

    Raises:
        RobrainError: the robot cannot start, in words.

    """
    sys.setswitchinterval(min(SWITCH_INTERVAL_S, sys.getswitchinterval()))
    plugins = PluginThreads(host)
    wanted = threading.Event()
    host.on_wanted(wanted.set)
    try:
        host.start()
        plugins.follow()
        on_ready()
        while not should_stop():
            host.step()
            plugins.follow()
            wanted.wait(HOST_PERIOD_S)
            wanted.clear()
    finally:
        plugins.stop()
        host.close()
