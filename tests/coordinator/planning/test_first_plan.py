"""A rehearsal loads whatever makes plans: a problem, a search for better routes, and what is told of them."""

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.coordinator.planning import plan_search


def test_a_rehearsal_warms_the_kernels_searches_once_and_makes_a_plan_of_all_tasks(monkeypatch):
    warmed, searches, plans = [], [], []
    monkeypatch.setattr(plan_search, "warm_up", lambda: warmed.append(True))
    search, planned = OptimalAllocator.plan, plan_search.planned

    def searching(*args, **fields):
        searches.append(fields["iterations"])
        return search(*args, **fields)

    def telling(*args):
        plans.append(planned(*args))
        return plans[-1]

    monkeypatch.setattr(OptimalAllocator, "plan", searching)
    monkeypatch.setattr(plan_search, "planned", telling)
    plan_search.rehearse()
    assert warmed == [True]
    assert len(searches) == 1
    (made,) = plans
    assert sorted(job for _, jobs in made.problem.routes for job in jobs) == ["t0", "t1", "t2"]
    assert {worker for worker, _ in made.problem.routes} <= {"r1", "r2"}
    assert made.problem.rounds == 1
