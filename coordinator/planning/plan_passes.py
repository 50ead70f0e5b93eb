"""Refinement passes: functions, found by name, that take a plan and return a preferred one.

`[planning] passes` of a scenario or a planning file lists them in the order in which they are applied. A pass of
another distribution is checked. If it raises, or its plan is not feasible, the failure is counted and reported with the
line of its file. The plan before it stays. A lockstep run ends with the failure.

    [project.entry-points."robrain.plan_passes"]
    rest_at_noon = "my_team.rest:rest_at_noon"
"""

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import msgspec

from robrain.algorithms.allocation.allocator import Allocator
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Problem
from robrain.protocol.model.ranges import cut
from robrain.protocol.registry import Registry, failure_text

STABILITY: Final = "stability"
CHARGING_ROBOTS: Final = "charging_robots"
EARLY_START: Final = "early_start"
STOCK_PASSES: Final = (STABILITY, CHARGING_ROBOTS, EARLY_START)
"""The passes that are applied by default."""


class PlanFailure(msgspec.Struct, frozen=True):
    """A failure of another distribution's code while a plan was made, or a plan of it that was rejected."""

    what: str
    """`plan_pass` or `allocator`."""
    name: str
    reason: str


class PlanDraft(msgspec.Struct, frozen=True, kw_only=True):
    """A plan to refine, and its inputs."""

    asked: Problem
    """The problem as it was posed, with chargers where robots may charge between two jobs."""
    problem: Problem
    """The problem that the plan solves: `asked`, in which robots have chargers only if the plan uses them."""
    plan: Plan
    orders: Mapping[str, Sequence[str]]
    """The previous plan: each robot's jobs in order."""
    gain_min: float
    """Minimum relative improvement for jobs to change robots."""
    allocator: Allocator
    """The allocator that made the plan; it can make others."""
    failures: tuple[PlanFailure, ...] = ()
    """Failures of other distributions' code up to now."""

    def with_plan(self, plan: Plan) -> "PlanDraft":
        """The draft with another plan for the same problem."""
        return msgspec.structs.replace(self, plan=plan)

    def with_failure(self, what: str, name: str, reason: str) -> "PlanDraft":
        """The draft with one more failure."""
        return msgspec.structs.replace(self, failures=(*self.failures, PlanFailure(what, name, cut(reason))))


class Pass(Protocol):
    """Refines plans. Equal drafts must give equal plans."""

    def __call__(self, draft: PlanDraft) -> PlanDraft:
        """Return a draft with the preferred plan, or the same draft.

        Of the result of a pass of another distribution, only `plan` counts. It must pass
        `robrain.algorithms.allocation.validate.validate`, have the same objective, and begin each robot's route with
        the jobs that the robot is doing (`Job.pinned_to`).
        """
        ...


PASSES: Registry[Pass] = Registry(
    "pass",
    "robrain.plan_passes",
    {
        STABILITY: "robrain.coordinator.planning.plan_search:stability",
        CHARGING_ROBOTS: "robrain.coordinator.planning.plan_search:charging_robots",
        EARLY_START: "robrain.coordinator.planning.plan_search:early_start",
    },
    has_files=True,
)


def refined(draft: PlanDraft, passes: Sequence[str]) -> PlanDraft:
    """Apply the named passes in order; one that fails is skipped."""
    for name in passes:
        refine = None
        try:
            refine = PASSES.get(name)
            made = refine(draft)
            draft = made if PASSES.is_stock(name) else draft.with_plan(_checked(draft, made))
        except Exception as error:
            if PASSES.is_stock(name):
                raise
            draft = draft.with_failure("plan_pass", name, failure_text(refine, error))  # foreign code
    return draft


def _checked(draft: PlanDraft, refined: object) -> Plan:
    # Here: it imports the allocators' kernels, and names of passes are also checked in processes that do not plan.
    from robrain.algorithms.allocation.validate import validate

    if not isinstance(refined, PlanDraft):
        raise TypeError(f"expected a PlanDraft, got {type(refined).__name__}")
    plan = refined.plan
    if plan.objective is not draft.plan.objective:
        raise ValueError(f"expected a plan for {draft.plan.objective}, got one for {plan.objective}")
    if faults := validate(draft.problem, plan):
        raise ValueError(f"the plan cannot be carried out: {'; '.join(faults)}")
    pinned = {job.id for job in draft.problem.jobs if job.pinned_to}
    for before, after in zip(draft.plan.routes, plan.routes, strict=True):
        begun = tuple(job for job in before.jobs if job in pinned)
        if after.jobs[: len(begun)] != begun:
            raise ValueError(f"{before.worker} is at {', '.join(begun)}; the plan does not begin with that")
    known = {one.job: one.reason for one in draft.plan.unassigned}
    missing = [one.job for one in plan.unassigned if one.reason is None and known.get(one.job) is None]
    if missing:
        raise ValueError(f"jobs are left out without a reason: {', '.join(missing)}")
    left = tuple(msgspec.structs.replace(one, reason=one.reason or known[one.job]) for one in plan.unassigned)
    return msgspec.structs.replace(plan, unassigned=left)
