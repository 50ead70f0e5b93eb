"""PyVRP's iterated local search (Wouda, Lan, Kool: PyVRP, INFORMS J. Comput. 2024), stopped by robrain's own clock."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

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

from robrain.coordinator.allocation.allocator import Effort
from robrain.coordinator.allocation.vrp_model import J_UNITS, MAX_PENALTY, S_UNITS

NEIGHBOURS = 20
"""Found by experiment, like the figures of `WARM`: 20 × 200 and 100 × 1000, five seconds of one core, three seeds."""
LARGE = 500
"""From this many visits on, memory is shorter and steps are smaller, so that one step stays short."""


class Way(NamedTuple):
    """Parameters of a search."""

    perturbation: PerturbationParams
    first_penalties: tuple[float, float, float]
    """Penalties per unit of excess load, time and energy."""
    penalties: PenaltyParams
    history: int
    large_history: int


WARM = Way(
    PerturbationParams(20, 40),
    (J_UNITS, 30.0 * J_UNITS / S_UNITS, 30.0),
    PenaltyParams(solutions_between_updates=200, min_penalty=1e-4, max_penalty=1e4),
    100,
    50,
)
"""From a plan: large steps, and small violations are soon tolerated."""
COLD = Way(PerturbationParams(1, 25), (5e4, 5e4, 5e4), PenaltyParams(max_penalty=MAX_PENALTY), 300, 50)
"""From a random start, as PyVRP's defaults: small steps, and violations are not tolerated for a long time. Each of the
two sometimes finds what the other does not."""


class Search:
    """Searches of one model, each with its own limits.

    Args:
        data: of the model; neighbours of visits are computed once.

    """

    def __init__(self, data: ProblemData) -> None:
        self._neighbours = compute_neighbours(data, NeighbourhoodParams(num_neighbours=NEIGHBOURS))
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
            end_left_s: stop when no more than this is left of the deadline.
            iterations: stop after this many.
            is_enough: stop at a solution for which this is true.

        """
        generator = RandomNumberGenerator(seed=seed % 2**32)
        way = WARM if start is not None else COLD
        local_search = LocalSearch(data, generator, self._neighbours, PerturbationManager(way.perturbation))
        for operator in OPERATORS:
            if operator.supports(data):
                local_search.add_operator(operator(data))
        load, time, energy = way.first_penalties
        penalties = PenaltyManager(([load] * data.num_load_dimensions, time, energy), way.penalties)
        if start is None:
            start = local_search(Solution.make_random(data, generator), penalties.max_cost_evaluator(), exhaustive=True)
        watch = _Watch(self, effort, end_left_s, iterations, patience, is_enough)
        parameters = IteratedLocalSearchParams(
            history_length=way.history if data.num_clients < LARGE else way.large_history,
            exhaustive_on_best=data.num_clients < LARGE,
            callbacks=watch,
        )
        search = IteratedLocalSearch(data, penalties, local_search, start, parameters)
        with warnings.catch_warnings():
            # An infeasible limit is a regular result here, no error.
            warnings.simplefilter("ignore", PenaltyBoundWarning)
            best = search.run(watch, collect_stats=False, display=False).best
        return best if best.is_feasible() else None


class _Watch(IteratedLocalSearchCallbacks):
    """Stops the search, and measures the duration of a step."""

    def __init__(
        self,
        search: Search,
        effort: Effort,
        end_left_s: float,
        iterations: float,
        patience: int,
        is_enough: Callable[[Solution], bool] | None,
    ) -> None:
        self._search = search
        self._effort = effort
        self._end_left_s = end_left_s
        self._iterations = iterations
        self._patience = patience
        self._patience_left = patience
        self._is_enough = is_enough
        self._found_enough = False
        self._last_left_s = effort.left_s

    def __call__(self, best_cost: float) -> bool:
        left_s = self._effort.left_s
        if left_s < self._last_left_s:
            self._search.longest_s = max(self._search.longest_s, self._last_left_s - left_s)
            self._last_left_s = left_s
        if self._found_enough or min(self._iterations, self._patience_left, self._effort.left_iterations) <= 0:
            return True
        if left_s <= self._end_left_s + 1.5 * self._search.longest_s:
            return True
        self._iterations -= 1
        self._patience_left -= 1
        self._effort.spend()
        return False

    def on_best(self, best: Solution) -> None:
        """See PyVRP."""
        self._patience_left = self._patience
        if self._is_enough is not None and best.is_feasible():
            self._found_enough = self._is_enough(best)
