"""Long actions: starting one returns an id at once; events report progress and the end.

class Gripper(Unit):
    progress = Event[ActionProgress](outside=True)
    finished = Event[ActionEnd](outside=True)

    def init(self) -> None:
        self._actions = Actions(self.env, self.progress, self.finished)

    @external
    def close(self) -> ActionId:
        self._action = self._actions.start("close")
        return self._action.id

    def step(self) -> None:
        if self._action.is_running:
            self._action.progress(self._share_closed())
            if self._share_closed() >= 1.0:
                self._action.done()

    @external
    def cancel(self, action: str) -> bool:
        return self._actions.cancel(action)

A call that starts another action supersedes the running one; so does a call of the plugin's that runs
`action.supersede()`. An action that runs when the plugin is deactivated, faults or is halted ends as cancelled.
"""

import threading
from typing import TYPE_CHECKING, Any

from robrain.agent.event import Event
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionId, ActionProgress, Outcome

if TYPE_CHECKING:
    from robrain.agent.environment import Environment

PROGRESS_PERIOD_NS = to_ns(0.5)
NS_PER_MS = 1_000_000


class Action:
    """One action; made by `Actions.start`. Calls after its end do nothing."""

    def __init__(self, action_id: ActionId, actions: "Actions") -> None:
        self.id = action_id
        self.end: ActionEnd | None = None
        """None while it is running."""
        self._actions = actions
        self._publish_ns = actions.env.clock.now_ns() + PROGRESS_PERIOD_NS

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self.end is None

    def progress(self, share: float) -> None:
        """Report progress, 0 to 1; may be called at any rate, and is notified at most twice a second."""
        now_ns = self._actions.env.clock.now_ns()
        if self.is_running and now_ns >= self._publish_ns:
            self._publish_ns = now_ns + PROGRESS_PERIOD_NS
            self._actions.progress.notify(ActionProgress(action=self.id, share=min(max(share, 0.0), 1.0)))

    def done(self, result: Any = None) -> None:
        """It has come to its end."""
        self._actions.end(self, ActionEnd(action=self.id, outcome=Outcome.DONE, result=result))

    def fail(self, reason: str) -> None:
        """It cannot be brought to its end."""
        self._actions.end(self, ActionEnd(action=self.id, outcome=Outcome.FAILED, why=reason))

    def supersede(self, by: str = "") -> None:
        """Another action, or another call, has taken its place.

        Args:
            by: name of that; the plugin of the current call if empty.

        """
        by = by or self._actions.env.caller or "a call from outside"
        end = ActionEnd(action=self.id, outcome=Outcome.SUPERSEDED, why=f"superseded by {by}", by=by)
        self._actions.end(self, end)

    def cancel(self, reason: str) -> None:
        """It is not wanted any more."""
        self._actions.end(self, ActionEnd(action=self.id, outcome=Outcome.CANCELLED, why=reason))


class Actions:
    """The actions of one plugin. A new action supersedes the running one. May be used from any thread.

    Args:
        env: the plugin's; it notifies the desk when the plugin ends or is halted.
        progress: called with each action's progress.
        finished: called with each action's end.

    """

    def __init__(self, env: "Environment", progress: Event[ActionProgress], finished: Event[ActionEnd]) -> None:
        self.env = env
        self.progress = progress
        self._finished = finished
        self._lock = threading.Lock()
        self._running: dict[str, Action] = {}
        # As the coordinator's epochs: a plugin that starts again, or another instance, does not reuse an id.
        self._count = env.clock.now_ns() // NS_PER_MS
        env.at_end(self.cancel_all)

    def start(self, name: str) -> Action:
        """A new action, named `NAME-NUMBER`."""
        with self._lock:
            self._count += 1
            action = Action(ActionId(f"{name}-{self._count}"), self)
            before = list(self._running.values())
            self._running[action.id] = action
        for other in before:
            other.supersede(self.env.caller or action.id)
        return action

    def running(self) -> list[Action]:
        """The actions that have not ended, oldest first."""
        with self._lock:
            return list(self._running.values())

    def cancel(self, action: str, reason: str = "it was cancelled") -> bool:
        """Cancel one by its id; False if none of that id is running."""
        with self._lock:
            found = self._running.get(action)
        if found is None:
            return False
        found.cancel(reason)
        return True

    def cancel_all(self, reason: str) -> None:
        """Cancel all that are running."""
        for action in self.running():
            action.cancel(reason)

    def end(self, action: Action, end: ActionEnd) -> None:
        """An action has ended; of two threads that end one, the first decides."""
        with self._lock:
            if self._running.pop(action.id, None) is None:
                return
            action.end = end
        self._finished.notify(end)
