"""The searching allocator: an auction first, then PyVRP for the remaining time.

Features that PyVRP's model does not have are handled around it:

- precedence and k robots at once: time windows from the best plan so far (`coupling.py`), rebuilt several times with
  more and with less slack;
- makespan and least remaining energy: PyVRP has neither as an objective. A limit is tightened step by step. Each search
  starts from the best plan so far, which slightly violates the new limit;
- energy used while waiting (`Worker.wait_w`): plans are made without it, then corrected by leaving jobs out;
- charges within routes: with `Worker.chargers`, `RuinRecreate` searches instead of PyVRP;
- a price of time: with `Job.delay_w`, `Reinsertion` searches instead of PyVRP.

Every result is scheduled and checked in floats before it is used.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from pyvrp import (
    IteratedLocalSearch,
    IteratedLocalSearchCallbacks,
    IteratedLocalSearchParams,
    PenaltyManager,
    PenaltyParams,
    ProblemData,
    RandomNumberGenerator,
    Solution,
)
from pyvrp.exceptions import PenaltyBoundWarning
from pyvrp.search import (
    OPERATORS,
    LocalSearch,
    NeighbourhoodParams,
    PerturbationManager,
    PerturbationParams,
    compute_neighbours,
)

from robrain.algorithms.allocation.allocator import Effort, Monotonic
from robrain.algorithms.allocation.auction import ROUNDS, AuctionAllocator, repaired
from robrain.algorithms.allocation.coupling import HORIZON_SHARE, Windows, windows_of
from robrain.algorithms.allocation.explain import reasons
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Objective, Problem, ProblemArrays, make_arrays
from robrain.algorithms.allocation.reinsertion import Reinsertion
from robrain.algorithms.allocation.ruin_recreate import RuinRecreate
from robrain.algorithms.allocation.vrp_model import J_UNITS, MAX_PENALTY, S_UNITS, VrpModel

NEIGHBOURS = 20
"""Found by experiment, like the figures of `WARM`: 20 × 200 and 100 × 1000, five seconds of one core, three seeds."""
LARGE = 500
"""From this many visits on, memory is shorter and steps are smaller, so that one step stays short."""


class SearchParameters(NamedTuple):
    """Parameters of a search."""

    perturbation: PerturbationParams
    first_penalties: tuple[float, float, float]
    """Penalties per unit of excess time and energy, and per mean load of a visit."""
    penalties: PenaltyParams
    history: int
    large_history: int


WARM = SearchParameters(
    PerturbationParams(20, 40),
    (J_UNITS, 30.0 * J_UNITS / S_UNITS, 30.0),
    PenaltyParams(solutions_between_updates=200, min_penalty=1e-4, max_penalty=1e4),
    100,
    50,
)
"""From a plan: large steps, and small violations are soon tolerated."""
COLD = SearchParameters(PerturbationParams(1, 25), (5e4, 5e4, 5e4), PenaltyParams(max_penalty=MAX_PENALTY), 300, 50)
"""From a random start, as PyVRP's defaults: small steps, and violations are not tolerated for a long time. Each of the
two sometimes finds a plan that the other does not. With loads, these are better from a plan too."""


class VrpSearch:
    """Searches of one model, each with its own limits.

    Args:
        data: of the model; neighbours of visits are computed once.

    """

    def __init__(self, data: ProblemData) -> None:
        self._neighbours = compute_neighbours(data, NeighbourhoodParams(num_neighbours=NEIGHBOURS))
        loads = [np.add(client.delivery, client.pickup) for client in data.clients()]
        loads += [np.array(shipment.amount) for shipment in data.shipments()]
        self._mean_loads = [
            float(np.mean([one[dim] for one in loads if one[dim]] or [1])) for dim in range(data.num_load_dimensions)
        ]
        self._has_loads = data.num_shipments > 0 or any(sum(client.pickup) for client in data.clients())
        self.patience_per_visit = LOADS_PATIENCE_PER_VISIT if self._has_loads else PATIENCE_PER_VISIT
        self._visits = data.num_clients + 2 * data.num_shipments
        self.longest_s = 0.0
        """Longest step seen, in seconds; a step cannot be interrupted."""

    def run(
        self,
        data: ProblemData,
        start: Solution | None,
        effort: Effort,
        seed: int,
        *,
        patience: int,
        end_left_s: float = 0.0,
        iterations: float = float("inf"),
        is_enough: Callable[[Solution], bool] | None = None,
    ) -> Solution | None:
        """Return the best feasible solution found; None if there is none.

        Args:
            data: of the model, possibly with limits.
            start: first solution, feasible or not; None for a random one.
            effort: stops the search, and is spent by it.
            seed: of the search.
            patience: stop after this many iterations without improvement.
            end_left_s: stop when no more than this remains of the deadline.
            iterations: stop after this many.
            is_enough: stop at a solution for which this is true.

        """
        generator = RandomNumberGenerator(seed=seed % 2**32)
        chosen = COLD if start is None or self._has_loads else WARM
        local_search = LocalSearch(data, generator, self._neighbours, PerturbationManager(chosen.perturbation))
        for operator in OPERATORS:
            if operator.supports(data):
                local_search.add_operator(operator(data))
        load, time, energy = chosen.first_penalties
        penalties = PenaltyManager(([load / mean for mean in self._mean_loads], time, energy), chosen.penalties)
        if start is None:
            start = local_search(Solution.make_random(data, generator), penalties.max_cost_evaluator(), exhaustive=True)
        watch = _Limits(self, effort, end_left_s, iterations, patience, is_enough)
        parameters = IteratedLocalSearchParams(
            history_length=chosen.history if self._visits < LARGE else chosen.large_history,
            exhaustive_on_best=self._visits < LARGE,
            callbacks=watch,
        )
        search = IteratedLocalSearch(data, penalties, local_search, start, parameters)
        with warnings.catch_warnings():
            # An infeasible limit is a regular result here, no error.
            warnings.simplefilter("ignore", PenaltyBoundWarning)
            best = search.run(watch, collect_stats=False, display=False).best
        return best if best.is_feasible() else None


class _Limits(IteratedLocalSearchCallbacks):
    """Stops the search, and measures the duration of a step."""

    def __init__(
        self,
        search: VrpSearch,
        effort: Effort,
        end_left_s: float,
        iterations: float,
        patience: int,
        is_enough: Callable[[Solution], bool] | None,
    ) -> None:
        self._search = search
        self._effort = effort
        self._end_remaining_s = end_left_s
        self._iterations = iterations
        self._patience = patience
        self._patience_remaining = patience
        self._is_enough = is_enough
        self._found_enough = False
        self._last_remaining_s = effort.left_s

    def __call__(self, best_cost: float) -> bool:
        left_s = self._effort.left_s
        if left_s < self._last_remaining_s:
            self._search.longest_s = max(self._search.longest_s, self._last_remaining_s - left_s)
            self._last_remaining_s = left_s
        if self._found_enough or min(self._iterations, self._patience_remaining, self._effort.left_iterations) <= 0:
            return True
        if left_s <= self._end_remaining_s + 1.5 * self._search.longest_s:
            return True
        self._iterations -= 1
        self._patience_remaining -= 1
        self._effort.spend()
        return False

    def on_best(self, best: Solution) -> None:
        """See PyVRP."""
        self._patience_remaining = self._patience
        if self._is_enough is not None and best.is_feasible():
            self._found_enough = self._is_enough(best)


SHARES = (0.5, 0.2, 0.8, 0.35, 0.65, 0.1)
"""Position within its slack at which each coupled job is fixed, round by round (chosen to try early and late)."""
STEP = 0.1
"""First step of a limit, as a share of the makespan or of the possible remaining energy."""
LEAST_STEP = 0.005
PATIENCE = 100
PATIENCE_PER_VISIT = 6
LOADS_PATIENCE_PER_VISIT = 40
"""Iterations without improvement after which a search ends. Found by experiment: late acceptance is then stuck."""
FRUITLESS = 12
"""Consecutive searches without improvement after which the search gives up."""
RANDOM_S_PER_CELL = 2e-6
"""Making a random start feasible took 0.05 s for 400 visits; this is six times that, for a busy machine."""
COUPLED_FRUITLESS = 60
"""As `FRUITLESS`, where jobs are coupled and other times for them are tried."""
MODEL_S_PER_CELL = 1e-7
"""Building a model took 0.07 s for 4 profiles of 1,100² paths; this is four times that, for a busy machine."""
COUPLED_SHARE = 0.3
"""Share of the effort for each search with charges, where jobs are coupled and other times for them are tried."""
OUTWEIGHS = 1e6
"""Factor of prizes that makes them outweigh any path."""
CHECK_S_PER_JOB = 4e-5
"""Converting and checking a solution took 6 ms for 1,000 jobs; this is several times that, for a busy machine."""


class OptimalAllocator:
    """Plans by search. It answers within its deadline, never worse than the auction or the warm start.

    Args:
        objective: the objective of its plans.
        monotonic: the clock that deadlines refer to.

    """

    def __init__(self, objective: Objective, monotonic: Monotonic) -> None:
        self.objective = objective
        self._monotonic = monotonic
        self._auction = AuctionAllocator(objective)

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """See `Allocator`. Raises ValueError if neither deadline nor iterations are given."""
        effort = Effort(self._monotonic, deadline_s, iterations)
        left_s = effort.left_s
        first = self._auction.plan(problem, warm_start=warm_start)
        auction_s = left_s - effort.left_s if math.isfinite(left_s) else 0.0
        best = _Improvement(problem, first, effort, seed, auction_s).run()
        return best if best is first else reasons(problem, make_arrays(problem), best, {})


class _Improvement:
    """The best plan of one problem, while it is improved."""

    def __init__(self, problem: Problem, first: Plan, effort: Effort, seed: int, auction_s: float) -> None:
        self.best = first
        self._problem = problem
        self._effort = effort
        self._seed = seed
        self._arrays: ProblemArrays = make_arrays(problem)
        self._is_coupled = bool(problem.coupled)
        self._check_s = CHECK_S_PER_JOB * len(problem.jobs)
        self._auction_s = auction_s
        self._searches = 0
        self._auction = AuctionAllocator(first.objective)
        self._kept_model: tuple[Windows, VrpModel, VrpSearch] | None = None
        self._may_be_complete = True
        """Whether no search failed to find a plan with every visit."""

    def run(self) -> Plan:
        """Search until the effort is spent."""
        places = len(self._arrays.visits.job) + len(self._problem.workers)
        self._model_s = MODEL_S_PER_CELL * places**2 * self._problem.energy_j.shape[0]
        if len(self._arrays.visits.job) and max(self._arrays.team.usable_j, default=-1.0) >= 0:
            match self.best.objective:
                case Objective.ENERGY:
                    self._save_energy()
                case Objective.MAKESPAN:
                    if self.best.lost_prize_j > 0:
                        self._search(0.2)
                    self._shorten()
                case Objective.LIFETIME:
                    if self.best.lost_prize_j > 0:
                        self._search(0.2)
                    self._level()
        return self.best

    @property
    def _has_time(self) -> bool:
        return self._effort.left_iterations > 0 and self._effort.left_s > self._model_s + 2 * self._check_s

    def _save_energy(self) -> None:
        """Search alternately from the best plan and from random ones, until neither improves or the effort is spent.

        While the best plan leaves visits out, searches from random plans require every visit. Optional visits make a
        search accept plans without them too soon. The first such search that fails is the last one.
        """
        fruitless = attempt = 0
        random_start_s = RANDOM_S_PER_CELL * len(self._arrays.visits.job) ** 2
        while fruitless < (COUPLED_FRUITLESS if self._is_coupled else FRUITLESS) and self._has_time:
            is_random = attempt % 2 == 1 and self._effort.left_s > random_start_s
            if is_random and self._is_coupled and self._effort.left_s > 2 * self._auction_s + self._model_s:
                # The search does not change times, so other times are drawn.
                is_better = self._search(1.0, base=self._drawn())
            else:
                is_better = self._search(1.0, is_random=is_random and not self._is_coupled)
            fruitless = 0 if is_better else fruitless + 1
            attempt += 1

    def _drawn(self) -> Plan:
        """An auction's plan with random times and robots for coupled jobs."""
        rule, choice = ROUNDS[self.best.objective][self._searches % 3]
        rng = np.random.default_rng((self._seed, self._searches))
        return self._auction.hold(self._problem, rule, choice, rng)[0]

    def _model(self, base: Plan, room_s: float) -> tuple[Windows, VrpModel, VrpSearch]:
        """Model around the best plan so far; without coupled jobs, one model serves all plans."""
        if self._kept_model is not None:
            return self._kept_model
        share = SHARES[self._searches % len(SHARES)]
        windows = windows_of(self._problem, self._arrays, base, share, room_s)
        model = VrpModel(self._problem, self._arrays, windows.visits, windows.required, self.best.objective)
        made = windows, model, VrpSearch(model.data)
        if not self._is_coupled:
            self._kept_model = made
        return made

    def _search(
        self,
        share: float,
        end_s: float = math.inf,
        left_j: float = 0.0,
        *,
        is_random: bool = False,
        base: Plan | None = None,
    ) -> bool:
        """Run one search with a share of the effort, from `base`, otherwise from the best plan so far.

        Returns:
            Whether it found a better plan within the limits.

        """
        if not self._has_time:
            return False
        effort = self._effort
        is_limited = math.isfinite(end_s) or left_j > 0
        base = base or self.best
        room_s = end_s if math.isfinite(end_s) else base.makespan_s * HORIZON_SHARE
        if self._arrays.team.charger.size:
            return self._is_better(self._recharged(base, room_s, share, end_s, left_j))
        if self.best.objective is Objective.ENERGY and self._arrays.visits.delay_w.any():
            return self._is_better(self._reinserted(base, room_s))
        windows, model, search = self._model(base, room_s)
        data = model.limited(end_s, left_j) if is_limited else model.data
        is_complete = is_random and self.best.lost_prize_j > 0 and self._may_be_complete
        start = model.solution(data, self._visits_of(base, windows.rows.tolist()))
        lost = start.uncollected_prizes()
        found = search.run(
            model.complete() if is_complete else data,
            None if is_random else start,
            effort,
            self._seed + 1000 * self._searches,
            patience=PATIENCE + search.patience_per_visit * len(windows.rows),
            end_left_s=max(self._check_s, effort.left_s * (1 - share)) if math.isfinite(effort.left_s) else 0.0,
            iterations=math.ceil(effort.left_iterations * share) if math.isfinite(effort.left_iterations) else math.inf,
            is_enough=(lambda solution: solution.uncollected_prizes() <= lost) if is_limited else None,
        )
        self._searches += 1
        self._may_be_complete = self._may_be_complete and not (is_complete and found is None)
        return found is not None and self._is_better(self._named(windows, model.orders(found)))

    def _reinserted(self, base: Plan, room_s: float) -> list[list[str]]:
        """As `_search`, with a price of time; returns ids of jobs for each worker."""
        windows = windows_of(self._problem, self._arrays, base, SHARES[self._searches % len(SHARES)], room_s)
        search = Reinsertion(self._arrays.team, windows.visits, windows.required)
        start, seed = self._visits_of(base, windows.rows.tolist()), self._seed + 1000 * self._searches
        self._searches += 1
        return self._named(windows, search.run(start, self._effort, seed, end_left_s=self._check_s))

    def _recharged(self, base: Plan, room_s: float, share: float, end_s: float, left_j: float) -> list[list[str]]:
        """As `_search`, with charges within routes; returns ids of jobs for each worker."""
        windows = windows_of(self._problem, self._arrays, base, SHARES[self._searches % len(SHARES)], room_s)
        team, visits = self._arrays.team, windows.visits
        limited = team._replace(
            horizon_s=min(end_s, team.horizon_s), usable_j=team.usable_j - left_j, full_j=team.full_j - left_j
        )
        if self.best.objective is not Objective.ENERGY:
            visits = visits._replace(prize_j=visits.prize_j * OUTWEIGHS)
        search = RuinRecreate(limited, visits, windows.required)
        start = self._visits_of(base, windows.rows.tolist())
        orders = search.run(
            start,
            self._effort,
            self._seed + 1000 * self._searches,
            share=min(share, COUPLED_SHARE) if self._is_coupled else share,
            end_left_s=self._check_s,
        )
        self._searches += 1
        return self._named(windows, orders)

    def _named(self, windows: Windows, orders: Sequence[Sequence[int]]) -> list[list[str]]:
        """Ids of the jobs for each worker, from rows of the windows' visits."""
        jobs = self._arrays.visits.job
        return [
            [self._problem.jobs[index].id for index in pinned]
            + [self._problem.jobs[jobs[windows.rows[visit]]].id for visit in visits]
            for pinned, visits in zip(self._arrays.pinned, orders, strict=True)
        ]

    def _is_better(self, orders: Sequence[Sequence[str]]) -> bool:
        """Keep the plan of these orders if it is better than the best so far."""
        plan = repaired(self._problem, orders, self.best.objective)
        if plan is None or not plan.rank < self.best.rank:
            return False
        self.best = plan
        return True

    def _shorten(self) -> None:
        """Shorten the makespan: tighten the limit step by step."""
        step, fruitless = STEP, 0
        while fruitless < FRUITLESS and self._has_time and self.best.makespan_s > 0:
            is_better = self._search(0.25, end_s=self.best.makespan_s * (1 - step))
            fruitless = 0 if is_better else fruitless + 1
            if not is_better:
                step = max(step / 2, LEAST_STEP)

    def _level(self) -> None:
        """Raise the least remaining energy: tighten the limit step by step, up to the energy of the weakest robot."""
        most_j = min(float(worker.usable_j) for worker in self._problem.workers)
        step = 0.5
        while self._has_time and step >= LEAST_STEP:
            room_j = most_j - self.best.least_left_j
            if room_j <= 1e-3 or not self._search(0.25, left_j=max(0.0, self.best.least_left_j + step * room_j)):
                step /= 2

    def _visits_of(self, plan: Plan, index: list[int]) -> list[list[int]]:
        """The plan's orders as rows of the windows' visits, without pinned jobs."""
        rows: dict[str, list[int]] = {}
        for row, visit in enumerate(index):
            rows.setdefault(self._problem.jobs[self._arrays.visits.job[visit]].id, []).append(row)
        return [[rows[stop.job].pop(0) for stop in route.stops if stop.job in rows] for route in plan.routes]
