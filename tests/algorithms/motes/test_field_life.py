"""A mote field over its whole life: energy and readings are accounted for, and plans do what they are for."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.motes.field_life import FieldLife, FieldPlan, MoteSite, Routing, field_life
from robrain.algorithms.motes.mote_energy import DAY_S, mica2
from robrain.protocol.model.geometry import Point2D
from tests.algorithms.motes.fields import ORIGIN, scattered

ENERGY = mica2()


def site(seed: int, motes: int = 25, **fields: object) -> MoteSite:
    graph = scattered(seed, motes=motes, size_m=60.0 if motes > 20 else 40.0)
    return MoteSite(places=tuple(graph.places[:-1]), sink=ORIGIN, size_m=60.0, **fields)


def live(where: MoteSite, **plan: object) -> FieldLife:
    return field_life(where, FieldPlan(**plan))


PLANS = st.sampled_from(
    [
        {"routing": Routing.TREE},
        {"routing": Routing.LIFETIME},
        {"routing": Routing.NONE, "tours_per_day": 0.5},
        {"tours_per_day": 1.0, "goal_days": 400.0},
        {"tours_per_day": 1.0, "goal_days": 400.0, "rotates_duty": True},
    ]
)


@pytest.mark.slow
@given(seed=st.integers(0, 1000), plan=PLANS, memory=st.sampled_from([50, 30_000]))
@settings(max_examples=15, deadline=None)
def test_all_energy_and_every_reading_is_accounted_for(seed: int, plan: dict[str, object], memory: int) -> None:
    life = live(site(seed, 12, log_readings=memory), **plan)
    assert life.spent_j + life.left_j == pytest.approx(12 * ENERGY.capacity_j)
    assert life.left_j == pytest.approx(0.0, abs=1e-3)
    assert life.collected == pytest.approx(life.delivered + life.stored + life.lost)
    assert len(life.deaths_days) == 12
    assert life.deaths_days == sorted(life.deaths_days)
    assert life.first_days <= life.half_days <= life.last_days
    assert 0.0 <= life.delivery_ratio <= 1.0 + 1e-9
    assert 0.0 <= life.coverage <= 1.0


def test_mote_alone_lives_as_long_as_its_cells() -> None:
    where = MoteSite(places=(Point2D(5.0, 0.0),), sink=ORIGIN, size_m=10.0)
    life = live(where, routing=Routing.TREE)
    power_w = ENERGY.awake_w + (ENERGY.reading_j + ENERGY.send_j) / 60.0
    assert life.deaths_days == pytest.approx([ENERGY.capacity_j / power_w / DAY_S], rel=1e-4)
    assert life.delivered == pytest.approx(life.collected)
    assert life.age_h == pytest.approx(1.0 / 3600.0)


def test_cut_off_mote_s_readings_arrive_by_robot_alone() -> None:
    where = MoteSite(places=(Point2D(50.0, 0.0),), sink=ORIGIN, size_m=60.0)
    assert live(where).delivered == 0.0
    life = live(where, tours_per_day=2.0, goal_days=300.0)
    assert life.delivery_ratio > 0.99
    assert life.age_h == pytest.approx(6.0, abs=0.1)
    assert life.driven_m == pytest.approx(100.0 * 2 * 365, rel=0.01)


@pytest.mark.slow
def test_goal_is_reached_and_what_the_goal_allows_travels_at_once() -> None:
    where = site(3)
    alone, relieved = live(where), live(where, tours_per_day=1.0, goal_days=400.0)
    collected = live(where, routing=Routing.NONE, tours_per_day=1.0)
    assert alone.first_days < 350.0
    assert 380.0 < relieved.first_days <= collected.first_days
    assert relieved.news_age_h < 0.5 * collected.news_age_h
    assert relieved.robot_j < collected.robot_j


@pytest.mark.slow
def test_motes_in_turn_live_longer_and_cover_as_much() -> None:
    where = site(5, motes=60)
    all_on = live(where, tours_per_day=1.0, goal_days=500.0)
    in_turn = live(where, tours_per_day=1.0, goal_days=500.0, rotates_duty=True)
    assert in_turn.half_days > 1.5 * all_on.half_days
    assert in_turn.coverage > all_on.coverage - 0.01
