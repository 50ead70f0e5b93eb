"""The live drive of one robot: a thread for each plugin, and the host's own loop.

Emergency halts are heard on a thread that is neither; see `robrain.agent.host.halt_desk`.
"""

import sys
import threading
import time
from collections.abc import Callable

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin

HOST_PERIOD_S = 0.02
JOIN_TIMEOUT_S = 2.0
SWITCH_INTERVAL_S = 0.0002
"""How long a thread that is busy in Python may keep the others waiting: a halt passes through several of them."""


class PluginThread:
    """Calls one plugin's step every `period_s`, and delivers its notifications as they come."""

    def __init__(self, plugin: ManagedPlugin) -> None:
        self._plugin = plugin
        self._stopping = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"plugin-{plugin.name}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._plugin.mailbox.wake = self._wake.set
        self._thread.start()

    def ask_to_stop(self) -> None:
        """End after the step that is running."""
        self._stopping = True
        self._wake.set()

    def stop(self) -> None:
        """End, and wait for it; a step that hangs is abandoned (the thread is a daemon)."""
        self.ask_to_stop()
        self._thread.join(JOIN_TIMEOUT_S)
        self._plugin.mailbox.wake = None

    def _run(self) -> None:
        due_s = time.monotonic()
        was_passive = False
        while not self._stopping:
            period_s = self._plugin.period_s
            now_s = time.monotonic()
            if was_passive or self._plugin.mailbox.is_hurried:  # or was not there: no step was missed
                self._plugin.mailbox.is_hurried = False
                due_s = now_s
            was_passive = period_s is None
            if period_s is not None and now_s >= due_s:
                self._plugin.run_step()
                due_s += period_s
                now_s = time.monotonic()
                if now_s > due_s:  # the step took longer than its period: what was missed is not made up for
                    self._plugin.overruns += 1
                    due_s = now_s
            self._wake.wait(None if period_s is None else max(due_s - now_s, 0.0))
            self._wake.clear()
            if self._plugin.mailbox and not self._stopping:
                self._plugin.deliver()


class PluginThreads:
    """A thread for each plugin that is loaded; follows what is loaded and unloaded while the robot runs."""

    def __init__(self, host: AgentHost) -> None:
        self._host = host
        self._threads: dict[tuple[str, int, int], PluginThread] = {}

    def follow(self) -> None:
        """Start threads for plugins that are new, end those of plugins that have gone."""
        wanted = {
            (plugin.name, id(plugin), plugin.generation): plugin for plugin in self._host.manager.plugins.values()
        }
        for key in [key for key in self._threads if key not in wanted]:
            self._threads.pop(key).ask_to_stop()
        for key, plugin in wanted.items():
            if key not in self._threads:
                thread = self._threads[key] = PluginThread(plugin)
                thread.start()

    def stop(self) -> None:
        """End all."""
        for thread in self._threads.values():
            thread.ask_to_stop()
        for thread in self._threads.values():
            thread.stop()
        self._threads.clear()


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
