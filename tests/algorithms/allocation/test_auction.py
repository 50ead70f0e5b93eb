"""The compiled auction against one written in plain Python, which walks every route from its start for every bid."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from robrain.algorithms.allocation.auction import (
    GREATEST_GAIN,
    LEAST_BID,
    LEAST_PER_PRIZE,
    drop_unprofitable,
    hold_auction,
    queue_nearest,
)
from robrain.algorithms.allocation.explain import FITS, judge_visit
from robrain.algorithms.allocation.insertion import BY_ENERGY, BY_FINISH, BY_LEAST_LEFT, RouteBatch, empty_routes
from robrain.algorithms.allocation.problem import TeamArrays, VisitArrays

HORIZON_S = 2000.0


class _Walk(NamedTuple):
    """One route, walked from its start; `is_in_time` is False if a visit or the charger is reached too late."""

    end_s: float
    spent_j: float
    is_in_time: bool


def _instance(seed: int, *, wait_w: float, windows: bool) -> tuple[TeamArrays, VisitArrays]:
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
    )
    visits = VisitArrays(
        np.arange(count),
        workers + np.arange(count),
        draw.uniform(20.0, 900.0, count),
        draw.uniform(0.0, 30.0, count),
        draw.uniform(0.0, 50.0, count),
        earliest_s,
        earliest_s + draw.uniform(10.0, 200.0, count) if windows else np.full(count, HORIZON_S),
        draw.random((workers, count)) < 0.8,
    )
    return team, visits


def _walk(team: TeamArrays, visits: VisitArrays, worker: int, route: list[int]) -> _Walk:
    profile, place, now_s, spent_j, waited_s = team.profile[worker], team.start[worker], team.ready_s[worker], 0.0, 0.0
    is_in_time = True
    for visit in route:
        here = visits.place[visit]
        now_s = now_s + team.time_s[profile, place, here]
        spent_j += team.energy_j[profile, place, here] + visits.service_j[visit]
        start_s = max(now_s, visits.earliest_s[visit])
        waited_s += start_s - now_s
        is_in_time &= start_s <= visits.latest_s[visit]
        now_s, place = start_s + visits.service_s[visit], here
    if route:
        now_s += team.end_s[worker, place]
        spent_j += team.end_j[worker, place] + waited_s * team.wait_w[worker]
    return _Walk(float(now_s), float(spent_j), bool(is_in_time and now_s <= team.horizon_s))


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
            bid = {BY_ENERGY: more_j, BY_FINISH: walk.end_s, BY_LEAST_LEFT: walk.spent_j - team.usable_j[worker]}[rule]
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
            bid, _, taker = min(
                (*_bid(team, visits, routes, worker, visit, rule)[:2], worker) for worker in range(workers)
            )
            prize_j = visits.prize_j[visit]
            if bid < math.inf and not (rule == BY_ENERGY and bid >= prize_j):
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
@pytest.mark.parametrize(("wait_w", "windows"), [(0.0, False), (0.5, False), (0.5, True)])
def test_auction_gives_the_routes_of_the_plain_one(rule: int, choice: int, wait_w: float, windows: bool) -> None:
    given = 0
    for seed in range(8):
        team, visits = _instance(seed, wait_w=wait_w, windows=windows)
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


def test_bids_are_worked_out_anew_where_waiting_takes_little_energy() -> None:
    """In these instances another bid than the old best and the two new ones wins."""
    team, visits = _instance(158, wait_w=1.0, windows=True)
    _assert_as_plain(team, visits, BY_LEAST_LEFT, LEAST_BID)


@pytest.mark.parametrize(("seed", "choice"), [(29, GREATEST_GAIN), (234, LEAST_PER_PRIZE)])
def test_bids_are_worked_out_anew_where_waits_are_short(seed: int, choice: int) -> None:
    team, visits = _instance(seed, wait_w=0.0, windows=True)
    shorter = 1e-3
    team = team._replace(
        time_s=team.time_s * shorter,
        ready_s=team.ready_s * shorter,
        end_s=team.end_s * shorter,
        horizon_s=team.horizon_s * shorter,
    )
    visits = visits._replace(
        service_s=visits.service_s * shorter, earliest_s=visits.earliest_s * shorter, latest_s=visits.latest_s * shorter
    )
    _assert_as_plain(team, visits, BY_FINISH, choice)


def _assert_as_plain(team: TeamArrays, visits: VisitArrays, rule: int, choice: int) -> None:
    routes = empty_routes(team, visits)
    hold_auction(team, visits, routes, np.ones(len(visits.job), np.bool_), rule, choice)
    assert _orders(routes) == _auction(team, visits, rule, choice)


@pytest.mark.parametrize("rule", [BY_ENERGY, BY_FINISH])
@pytest.mark.parametrize("windows", [False, True])
def test_greedy_queue_takes_the_nearest_visit_of_the_robot_that_is_free_first(rule: int, windows: bool) -> None:
    for seed in range(8):
        team, visits = _instance(seed, wait_w=2.0, windows=windows)
        routes = empty_routes(team, visits)
        open_visits = np.ones(len(visits.job), np.bool_)
        queue_nearest(team, visits, routes, open_visits, rule)
        assert _orders(routes) == _greedy(team, visits, rule), f"seed {seed}"


def _greedy(team: TeamArrays, visits: VisitArrays, rule: int) -> list[list[int]]:
    routes: list[list[int]] = [[] for _ in team.start]
    free_s = team.ready_s.astype(float).tolist()
    active, left = set(range(len(routes))), set(range(len(visits.job)))
    while active:
        worker = min(active, key=lambda one: (free_s[one], one))
        place = visits.place[routes[worker][-1]] if routes[worker] else team.start[worker]
        choices = []
        for visit in left:
            way_j = team.energy_j[team.profile[worker], place, visits.place[visit]] + visits.service_j[visit]
            walk = _walk(team, visits, worker, [*routes[worker], visit])
            pays = rule != BY_ENERGY or way_j < visits.prize_j[visit]
            if visits.allowed[worker, visit] and pays and walk.is_in_time and walk.spent_j <= team.usable_j[worker]:
                choices.append((way_j, visit, walk.end_s - team.end_s[worker, visits.place[visit]]))
        if not choices:
            active.remove(worker)
            continue
        _, visit, free_s[worker] = min(choices)
        routes[worker].append(visit)
        left.remove(visit)
    return routes


def test_visits_and_whole_routes_that_cost_more_than_their_prizes_are_dropped() -> None:
    dropped = 0
    for seed in range(12):
        team, visits = _instance(seed, wait_w=0.0, windows=False)
        visits = visits._replace(prize_j=visits.prize_j / 4)
        routes = empty_routes(team, visits)
        open_visits = np.ones(len(visits.job), np.bool_)
        hold_auction(team, visits, routes, open_visits, BY_FINISH, LEAST_BID)  # does not look at prizes
        kept = np.zeros(len(visits.job), np.bool_)
        kept[::5] = True
        before = _orders(routes)
        drop_unprofitable(team, visits, routes, open_visits, kept)
        after = _orders(routes)
        dropped += sum(map(len, before)) - sum(map(len, after))
        assert after == [_profitable(team, visits, kept, worker, route) for worker, route in enumerate(before)]
        assert open_visits.tolist() == [not any(visit in route for route in after) for visit in range(12)]
    assert dropped > 5


def _profitable(team: TeamArrays, visits: VisitArrays, kept: np.ndarray, worker: int, route: list[int]) -> list[int]:
    route = list(route)

    def spent_j(visits_left: list[int]) -> float:
        return _walk(team, visits, worker, visits_left).spent_j

    while route:
        losses = [(spent_j(route) - spent_j([v for v in route if v != visit]) - visits.prize_j[visit], -position)
                  for position, visit in enumerate(route) if not kept[visit]]  # fmt: skip
        if not losses or max(losses)[0] <= 1e-9:
            break
        del route[-max(losses)[1]]
    is_kept = any(kept[visit] for visit in route)
    return route if is_kept or sum(visits.prize_j[visit] for visit in route) >= spent_j(route) else []


def test_judgement_of_a_visit_is_that_of_its_cheapest_insertion() -> None:
    judged = []
    for seed in range(20):
        team, visits = _instance(seed, wait_w=0.5, windows=seed % 2 == 1)
        routes = empty_routes(team, visits)
        open_visits = np.ones(len(visits.job), np.bool_)
        hold_auction(team, visits, routes, open_visits, BY_ENERGY, GREATEST_GAIN)
        orders = _orders(routes)
        for visit in np.flatnonzero(open_visits):
            for worker in range(len(orders)):
                more_j, _, position = _bid(team, visits, orders, worker, visit, BY_ENERGY)
                code, *_, found = judge_visit(team, visits, routes, worker, visit)
                assert (code == FITS) == (position >= 0)
                if code == FITS:
                    before, after = orders[worker][:position], orders[worker][position:]
                    walk = _walk(team, visits, worker, [*before, visit, *after])
                    told = judge_visit(team, visits, routes, worker, visit)
                    assert found == position
                    assert told[1] == pytest.approx(more_j)
                    assert told[2] == pytest.approx(walk.end_s - routes.end_s[worker])
                    assert told[4] == pytest.approx(team.usable_j[worker] - walk.spent_j)
                judged.append(code)
    assert judged.count(FITS) > 10
    assert len(set(judged)) > 2
