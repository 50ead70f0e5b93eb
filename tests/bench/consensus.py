"""Consensus: teams without a coordinator allocate tasks by messages, some of them lost; beside `optimal`.

The robots hear each other in rounds, as they do at a fixed rate; a lost ballot is not sent again. Nothing here depends
on the machine.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple
from zlib import crc32

import msgspec

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import Plan, make_plan
from robrain.algorithms.allocation.problem import Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.algorithms.consensus.negotiation import Negotiation
from robrain.algorithms.consensus.route_scorer import DriveCost, RouteScorer, RouteStop
from robrain.lab.bench.figure import Figure, at_most, deterministic
from tests.algorithms.allocation.instances import team_problem
from tests.bench.processes import show

SIZES = ((5, 50, 1.0), (10, 100, 0.3))
"""Robots, tasks, and the share of the problems that are measured."""
SEEDS = range(41, 45)
"""The parameters of the rounds were chosen on 1 to 40."""
TIGHTNESS = 0.75
ROUNDS = 600
"""Rounds of improvement (chosen: 5 × 50 then keeps its bound with the first ten seeds; 300 do not)."""
OPTIMAL_ITERATIONS = 1500
GAP_BOUND = 0.12
LOSS = 0.2
EXCHANGES_MAX = 20_000
"""Exchanges after which a team that has not agreed counts as one that does not."""


class NegotiationTrace(NamedTuple):
    """A negotiation of a team, seen from outside."""

    plan: Plan
    exchanges: int
    """How often every robot has sent its ballot."""
    messages: int
    bytes: int
    """Sum over all ballots sent."""
    largest: int
    """Bytes of the largest ballot."""
    first: int
    """Exchanges until the first allocation was agreed on."""


def scorer_of(problem: Problem, worker: Worker) -> RouteScorer:
    """What one robot knows of a problem."""
    stops = {
        job.id: RouteStop(job.place, job.prize_j, job.service_s, job.service_j, job.latest_s)
        for job in problem.jobs
        if job.admits(worker)
    }
    energy_j, time_s = (matrix[worker.profile].tolist() for matrix in (problem.energy_j, problem.time_s))
    drive = DriveCost(energy_j, time_s, worker.start, worker.ends, worker.usable_j)
    return RouteScorer(drive, stops)


def negotiate(problem: Problem, rounds: int, loss: float, seed: int) -> NegotiationTrace | None:
    """Have the robots of a problem allocate its jobs; None if they do not agree.

    Args:
        problem: its jobs are for one robot each and wait for no others.
        rounds: rounds of improvement.
        loss: share of the ballots that are lost, for each receiver apart.
        seed: of the losses.

    """
    members = [Negotiation(worker.name, scorer_of(problem, worker), rounds) for worker in problem.workers]
    way, place = problem.time_s[0], {job.id: job.place for job in problem.jobs}
    names = [worker.name for worker in problem.workers]
    for member in members:
        member.open(1, names, place, lambda one, other: float(way[place[one], place[other]]))
    messages = total = largest = first = 0
    is_lost = _losses(loss, seed)
    for exchange in range(1, EXCHANGES_MAX):
        ballots = [member.ballot() for member in members]
        sizes = [len(msgspec.json.encode(ballot)) for ballot in ballots]
        messages, total, largest = messages + len(ballots), total + sum(sizes), max(largest, *sizes)
        for member in members:
            for ballot in ballots:
                if ballot.robot != member.bidder.robot and not is_lost() and not member.receive(ballot):
                    return None
        first = first or (exchange if all(member.is_agreed for member in members) else 0)
        if all(member.is_over for member in members):
            plan = make_plan(problem, [member.path for member in members], Objective.ENERGY)
            return None if plan is None else NegotiationTrace(plan, exchange, messages, total, largest, first)
    return None


def _losses(loss: float, seed: int) -> Callable[[], bool]:
    """Whether the next message is lost; the same sequence for the same seed."""
    count = 0

    def is_lost() -> bool:
        nonlocal count
        count += 1
        return crc32(f"{seed}:{count}".encode()) < loss * 2**32

    return is_lost


def measure(sizes: Sequence[tuple[int, int, float]] = SIZES[:1], seeds: Sequence[int] = SEEDS) -> Iterator[Figure]:
    """All figures, one size after the other.

    Args:
        sizes: robots, tasks, and the share of the seeds that are used, the first ones, at least one.
        seeds: each makes a problem of its own.

    """
    for robots, tasks, share in sizes:
        used = seeds[: max(1, round(share * len(seeds)))]
        problems = [team_problem(robots, tasks, seed, tightness=TIGHTNESS) for seed in used]
        best = [
            OptimalAllocator(Objective.ENERGY, time.process_time).plan(one, iterations=OPTIMAL_ITERATIONS)
            for one in problems
        ]
        for rounds, loss in ((0, 0.0), (ROUNDS, 0.0), (ROUNDS, LOSS)):
            told = [negotiate(one, rounds, loss, seed) for one, seed in zip(problems, used, strict=True)]
            yield from _figures(f"{robots} × {tasks}", problems, best, told, rounds, loss)


def _figures(
    size: str, problems: list[Problem], best: list[Plan], told: list[NegotiationTrace | None], rounds: int, loss: float
) -> Iterator[Figure]:
    how = "bundles alone" if not rounds else f"{rounds} rounds"
    what = f"{size}, {how}, {loss:.0%} lost" if loss else f"{size}, {how}"
    agreed = [one for one in told if one is not None]
    broken = sum(
        bool(validate(problem, one.plan)) for problem, one in zip(problems, told, strict=True) if one is not None
    )
    yield deterministic(f"{what}: runs without agreement", len(told) - len(agreed), bound=at_most(0))
    yield deterministic(f"{what}: plans that break a rule", broken, bound=at_most(0))
    gaps = [100 * (one.plan.value / known.value - 1) for one, known in zip(told, best, strict=True) if one is not None]
    bound = at_most(100 * GAP_BOUND) if rounds else None
    beside = f"mean {_mean(gaps):.1f} %, {len(gaps)} problems"
    yield deterministic(f"{what}: largest gap to optimal", max(gaps, default=math.nan), "%", bound, beside)
    exchanges = [one.exchanges for one in agreed]
    beside = f"first allocation after {_mean([one.first for one in agreed]):.1f}"
    yield deterministic(f"{what}: exchanges until the end, mean", _mean(exchanges), beside=beside)
    beside = (
        f"{_mean([one.messages for one in agreed]):,.0f} ballots, "
        f"{_mean([one.bytes / one.messages for one in agreed]):,.0f} bytes each, "
        f"at most {max((one.largest for one in agreed), default=0):,}"
    )
    yield deterministic(
        f"{what}: sent by all robots, mean", _mean([one.bytes for one in agreed]) / 1000, "kB", beside=beside
    )


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values) if values else math.nan


if __name__ == "__main__":
    show("Allocation without a coordinator", measure(SIZES, range(1, 11)))
