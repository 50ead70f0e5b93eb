"""Planning in the live drive: on a thread of its own, so that the coordinator's loop never waits for a plan."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from robrain.coordinator.planning.planned import Planned
from robrain.coordinator.planning.planner import Drafting
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.situation import Situation

logger = logging.getLogger(__name__)

KEPT_PLANS = 4
JOIN_S = 5.0


class LivePlanner:
    """Answers with the auction's plan at once, and with a better one within the policy's deadline, if there is one.

    Only the last question waits; one that comes while a search runs ends it at the next round.

    Args:
        on_made: called on the planner's thread when a plan is there.

    """

    def __init__(self, on_made: Callable[[], None]) -> None:
        self._on_made = on_made
        self._waiting: deque[tuple[Situation, PlanningPolicy]] = deque(maxlen=1)
        self._made: deque[Planned] = deque(maxlen=KEPT_PLANS)
        self._wake = threading.Event()
        self._has_ended = False
        self._works = False
        self._thread = threading.Thread(target=self._run, name="planner", daemon=True)
        self._thread.start()

    def ask(self, situation: Situation, policy: PlanningPolicy) -> None:
        """See `Planner`; what still waits is forgotten."""
        self._waiting.append((situation, policy))
        self._wake.set()

    def take(self) -> list[Planned]:
        """See `Planner`."""
        return [self._made.popleft() for _ in range(len(self._made))]

    @property
    def is_busy(self) -> bool:
        """See `Planner`."""
        return self._works or bool(self._waiting) or bool(self._made)

    def close(self) -> None:
        """End the thread."""
        self._has_ended = True
        self._wake.set()
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        drafting = Drafting()
        while not self._has_ended:
            self._wake.wait()
            self._wake.clear()
            while self._waiting and not self._has_ended:
                self._works = True  # before the question is taken: somebody counts as busy at any moment
                try:
                    self._plan(drafting, *self._waiting.popleft())
                except Exception:  # a plan that cannot be made must not end planning: the next question may do
                    logger.exception("no plan could be made")
            self._works = False

    def _plan(self, drafting: Drafting, situation: Situation, policy: PlanningPolicy) -> None:
        begun_s = time.monotonic()
        draft = drafting.draft(situation, policy)
        first = draft.planned(time.monotonic() - begun_s)
        self._made.append(first)
        self._on_made()
        for _ in draft.improve():
            if time.monotonic() - begun_s > policy.deadline_s or self._waiting or self._has_ended:
                break
        better = draft.planned(time.monotonic() - begun_s)
        if better.problem.routes != first.problem.routes:
            self._made.append(better)
            self._on_made()
