"""The steps of a robot's plugins in lockstep: in start order, those that are due and those that something waits for."""

from heapq import heappop, heappush

from robrain.agent.lifecycle.managed_plugin import NEVER_NS, ManagedPlugin


class LockstepSchedule:
    """Runs the steps of one robot's plugins, one pass a tick.

    In a pass each plugin gets its notifications, then its step if that is due. What a plugin leaves for one that comes
    later is delivered in the same pass, for an earlier one in the next.

    Args:
        has_one_thread: whether plugins' turns need not be waited for.

    """

    def __init__(self, *, has_one_thread: bool) -> None:
        self._has_one_thread = has_one_thread
        self._plugins: list[ManagedPlugin] = []
        self._known: dict[str, ManagedPlugin] = {}
        self._wanted = bytearray()
        """For each plugin, 1 if the next pass must visit it: set by its mailbox and when its step is due."""
        self._due: list[tuple[int, int]] = []
        """A heap of due times and plugins; an entry may be void, as a plugin's `due_ns` counts."""
        self._queued: list[int] = []
        """The due time of each plugin's last entry in the heap; `NEVER_NS` if there is none."""

    def step(self, plugins: dict[str, ManagedPlugin], now_ns: int) -> None:
        """One pass over `plugins`, which are in start order."""
        if plugins is not self._known:
            self._rebuild(plugins)
        wanted, due, queued = self._wanted, self._due, self._queued
        while due and due[0][0] <= now_ns:
            _, index = heappop(due)
            wanted[index] = 1
            queued[index] = NEVER_NS
        index = wanted.find(1)
        while index >= 0:
            wanted[index] = 0
            plugin = self._plugins[index]
            if plugin.holdings.mailbox.waiting:
                if self._has_one_thread:
                    turn = plugin.turn
                    turn.depth += 1
                    try:
                        plugin.deliver_in_turn()
                    finally:
                        turn.depth -= 1
                else:
                    plugin.deliver()
            mailbox = plugin.holdings.mailbox  # another one if the plugin has faulted
            if mailbox.is_hurried:
                mailbox.is_hurried = False
                if plugin.period_ns:
                    plugin.due_ns = min(plugin.due_ns, now_ns - plugin.period_ns)
            if now_ns >= plugin.due_ns:
                plugin.due_ns += plugin.period_ns
                if plugin.due_ns <= now_ns:  # what was missed is not made up for
                    plugin.due_ns = now_ns + plugin.period_ns
                if self._has_one_thread:
                    turn = plugin.turn
                    turn.depth += 1
                    try:
                        plugin.step_in_turn()
                    finally:
                        turn.depth -= 1
                else:
                    plugin.run_step()
            if plugin.due_ns != queued[index]:
                queued[index] = plugin.due_ns
                heappush(due, (plugin.due_ns, index))
            index = wanted.find(1, index + 1)

    def _rebuild(self, plugins: dict[str, ManagedPlugin]) -> None:
        for plugin in self._plugins:
            plugin.holdings.ring_at(None, 0)
        self._known, self._plugins = plugins, list(plugins.values())
        self._wanted = bytearray(b"\1" * len(self._plugins))
        self._due = []
        self._queued = [NEVER_NS] * len(self._plugins)
        for index, plugin in enumerate(self._plugins):
            plugin.holdings.ring_at(self._wanted, index)
