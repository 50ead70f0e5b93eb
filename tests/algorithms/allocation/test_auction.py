"""The compiled auction against one written in plain Python, which walks every route from its start for every bid."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from robrain.algorithms.allocation.auction import GREATEST_GAIN, LEAST_BID, LEAST_PER_PRIZE, hold_auction
from robrain.algorithms.allocation.insertion import BY_ENERGY, BY_FINISH, BY_LEAST_LEFT, RouteBatch, empty_routes
from robrain.algorithms.allocation.problem import TeamArrays, VisitArrays

HORIZON_S = 2000.0


class _Walk(NamedTuple):
    """One route, walked from its start; `is_in_time` is False if a visit or the charger is reached too late."""

    end_s: float
    spent_j: float
    delay_j: float
    is_in_time: bool


def _instance(
    seed: int, *, wait_w: float, windows: bool, exit_share: float = 0.0, delay_w: float = 0.0
) -> tuple[TeamArrays, VisitArrays]:
    """4 workers of 2 profiles and 12 visits on a plane: detours are never shorter.

    With windows nobody lacks energy: where waiting takes energy, the compiled auction does not bid again for a visit
    that a worker had too little energy for.
    """
    draw = np.random.default_rng(seed)
    workers, count = 4, 12
    places = draw.uniform(0.0, 100.0, (workers + count + 2, 2))
    distance_m = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    profile = draw.integers(0, 2, workers)
    time_s = np.stack([distance_m / 1.0, distance_m / 1.7])
    energy_j = np.stack([distance_m * 2.0, distance_m * 5.0])
    charger = workers + count + draw.integers(0, 2, workers)
    earliest_s = draw.uniform(0.0, 300.0, count) * (draw.random(count) < 0.6) if windows else np.zeros(count)
    team = TeamArrays(
        energy_j,
        time_s,
        profile,
        np.arange(workers),
        draw.uniform(0.0, 40.0, workers),
        draw.uniform(*((4000.0, 5000.0) if windows else (200.0, 900.0)), workers),
        np.full(workers, wait_w),
        np.stack([energy_j[profile[worker], :, charger[worker]] for worker in range(workers)]),
        np.stack([time_s[profile[worker], :, charger[worker]] for worker in range(workers)]),
        HORIZON_S,
        np.full(workers, 5.0),
        np.zeros(workers),
        np.empty(0, np.int64),
        np.zeros((workers, 0), np.bool_),
        np.zeros(workers),
        np.zeros(workers),
    )
    visits = VisitArrays(
        np.arange(count),
        np.full(count, -1),
        np.full(count, -1),
        np.zeros(count),
        workers + np.arange(count),
        workers + np.arange(count),
        draw.uniform(20.0, 900.0, count),
        np.full(count, delay_w) * np.arange(count),
        draw.uniform(0.0, 30.0, count),
        draw.uniform(0.0, 50.0, count),
        earliest_s,
        earliest_s + draw.uniform(10.0, 200.0, count) if windows else np.full(count, HORIZON_S),
        draw.random((workers, count)) < 0.8,
    )
    for visit in range(round(exit_share * count)):
        exit_place = workers + int(draw.integers(count))
        visits.exit_place[visit] = exit_place
        visits.service_s[visit] += distance_m[workers + visit, exit_place]
        visits.service_j[visit] += 5.0 * distance_m[workers + visit, exit_place]
    return team, visits


def _walk(team: TeamArrays, visits: VisitArrays, worker: int, route: list[int]) -> _Walk:
    profile, place, now_s, spent_j, waited_s = team.profile[worker], team.start[worker], team.ready_s[worker], 0.0, 0.0
    delay_j, is_in_time = 0.0, True
    for visit in route:
        here = visits.place[visit]
        now_s = now_s + team.time_s[profile, place, here]
        spent_j += team.energy_j[profile, place, here] + visits.service_j[visit]
        start_s = max(now_s, visits.earliest_s[visit])
        waited_s += start_s - now_s
        is_in_time &= start_s <= visits.latest_s[visit]
        now_s, place = start_s + visits.service_s[visit], visits.exit_place[visit]
        delay_j += visits.delay_w[visit] * now_s
    if route:
        now_s += team.end_s[worker, place]
        spent_j += team.end_j[worker, place] + waited_s * team.wait_w[worker]
    return _Walk(float(now_s), float(spent_j), float(delay_j), bool(is_in_time and now_s <= team.horizon_s))


def _bid(
    team: TeamArrays, visits: VisitArrays, routes: list[list[int]], worker: int, visit: int, rule: int
) -> tuple[float, float, int]:
    before = _walk(team, visits, worker, routes[worker])
    best = (math.inf, math.inf, -1)
    for position in range(len(routes[worker]) + 1 if visits.allowed[worker, visit] else 0):
        route = [*routes[worker][:position], visit, *routes[worker][position:]]
        walk = _walk(team, visits, worker, route)
        if walk.is_in_time and walk.spent_j <= team.usable_j[worker]:
            more_j = walk.spent_j - before.spent_j
            more = more_j + walk.delay_j - before.delay_j
            bid = {BY_ENERGY: more, BY_FINISH: walk.end_s, BY_LEAST_LEFT: walk.spent_j - team.usable_j[worker]}[rule]
            best = min(best, (bid, more_j, position))
    return best


def _auction(team: TeamArrays, visits: VisitArrays, rule: int, choice: int) -> list[list[int]]:
    """Sequential single-item auction: every bid is worked out again in every round."""
    workers, count = visits.allowed.shape
    routes: list[list[int]] = [[] for _ in range(workers)]
    open_visits = set(range(count))
    while True:
        rounds = []
        for visit in open_visits:
            bid, more_j, taker = min(
                (*_bid(team, visits, routes, worker, visit, rule)[:2], worker) for worker in range(workers)
            )
            prize_j = visits.prize_j[visit]
            if bid < math.inf and not (rule == BY_ENERGY and more_j >= prize_j):
                value = {LEAST_BID: bid, GREATEST_GAIN: bid - prize_j, LEAST_PER_PRIZE: bid / prize_j}[choice]
                rounds.append((value, visit, taker))
        if not rounds:
            return routes
        _, visit, taker = min(rounds)
        routes[taker].insert(_bid(team, visits, routes, taker, visit, rule)[2], visit)
        open_visits.remove(visit)


def _orders(routes: RouteBatch) -> list[list[int]]:
    return [routes.order[worker, : routes.length[worker]].tolist() for worker in range(len(routes.length))]


@pytest.mark.parametrize("choice", [LEAST_BID, GREATEST_GAIN, LEAST_PER_PRIZE])
@pytest.mark.parametrize("rule", [BY_ENERGY, BY_FINISH, BY_LEAST_LEFT])
@pytest.mark.parametrize(
    ("wait_w", "windows", "exit_share", "delay_w"),
    [
        (0.0, False, 0.0, 0.0),
        (0.5, False, 0.0, 0.0),
        (0.5, True, 0.0, 0.0),
        (0.0, False, 0.5, 0.0),
        (0.5, True, 0.5, 0.0),
        (0.0, False, 0.5, 0.2),
    ],
)
def test_auction_gives_the_routes_of_the_plain_one(
    rule: int, choice: int, wait_w: float, windows: bool, exit_share: float, delay_w: float
) -> None:
    given = 0
    for seed in range(8):
        team, visits = _instance(seed, wait_w=wait_w, windows=windows, exit_share=exit_share, delay_w=delay_w)
        routes = empty_routes(team, visits)
        open_visits = np.ones(len(visits.job), np.bool_)
        hold_auction(team, visits, routes, open_visits, rule, choice)
        expected = _auction(team, visits, rule, choice)
        assert _orders(routes) == expected, f"seed {seed}"
        assert open_visits.tolist() == [not any(visit in route for route in expected) for visit in range(12)]
        for worker, route in enumerate(expected):
            walk = _walk(team, visits, worker, route)
            assert routes.end_s[worker] == pytest.approx(walk.end_s)
            assert routes.spent_j[worker] == pytest.approx(walk.spent_j)
        given += sum(map(len, expected))
    assert given > 20  # the instances are neither empty nor without refusals
    assert given < 8 * 12
