"""Planning in lockstep: there and then, with rounds instead of seconds."""

import logging
from functools import cache

from robrain.coordinator.allocation.warm_up import warm_up
from robrain.coordinator.planning.plan_in_force import Planned
from robrain.coordinator.planning.plan_search import Drafting
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Situation

logger = logging.getLogger(__name__)


class LockstepPlanner:
    """Plans when it is asked to, with so many rounds: equal runs have equal plans."""

    def __init__(self) -> None:
        _warm_up_once()
        self._drafting = Drafting()
        self._made: list[Planned] = []
        self.why_failed = ""
        """See `Planner`."""

    def prepare(self) -> None:
        """See `Planner`."""

    def ask(self, situation: Situation, policy: PlanningPolicy) -> None:
        """See `Planner`."""
        try:
            draft = self._drafting.draft(situation, policy)
            for _ in draft.improve():
                if draft.thinking.rounds >= policy.rounds:
                    break
            self._made.append(draft.planned())
            self.why_failed = ""
        except Exception as error:  # as in live: a planning error must not end the coordinator
            logger.exception("no plan %d could be made", situation.number)
            self.why_failed = f"{type(error).__name__}: {error}"

    def take(self) -> list[Planned]:
        """See `Planner`."""
        made, self._made = self._made, []
        return made

    @property
    def is_busy(self) -> bool:
        """See `Planner`."""
        return False

    def close(self) -> None:
        """See `Planner`."""


_warm_up_once = cache(warm_up)
