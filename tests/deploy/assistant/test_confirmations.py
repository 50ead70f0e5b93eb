"""Tokens of rehearsed orders."""

import itertools

import pytest

from robrain.deploy.assistant.assistant import Confirmations
from robrain.deploy.assistant.policy import Ban


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def orders(clock: Clock) -> Confirmations:
    numbers = itertools.count(1)
    return Confirmations(clock, lambda: f"token-{next(numbers)}", life_s=10.0, capacity=3)


def test_a_token_has_its_order_carried_out_once(orders: Confirmations) -> None:
    token = orders.keep("scripted", b"order", "plan")
    assert orders.redeem(token, "scripted", b"order") == "plan"
    assert orders.redeem(token, "scripted", b"order") is Ban.NO_TOKEN


@pytest.mark.parametrize(("who", "order"), [("scripted", b"another"), ("another", b"order"), ("", b"")])
def test_a_token_is_void_after_it_was_given_for_another_order_or_by_another_client(
    orders: Confirmations, who: str, order: bytes
) -> None:
    token = orders.keep("scripted", b"order", "plan")
    assert orders.redeem(token, who, order) is Ban.ANOTHER_ORDER
    assert orders.redeem(token, "scripted", b"order") is Ban.NO_TOKEN


def test_a_token_expires(orders: Confirmations, clock: Clock) -> None:
    early, late = orders.keep("scripted", b"1", "early"), orders.keep("scripted", b"2", "late")
    clock.now_s = 9.9
    assert orders.redeem(early, "scripted", b"1") == "early"
    clock.now_s = 10.0
    assert orders.redeem(late, "scripted", b"2") is Ban.EXPIRED


def test_of_too_many_orders_the_oldest_is_dropped_and_counted(orders: Confirmations) -> None:
    tokens = [orders.keep("scripted", b"order", f"plan-{number}") for number in range(5)]
    assert (len(orders), orders.dropped) == (3, 2)
    assert orders.redeem(tokens[1], "scripted", b"order") is Ban.NO_TOKEN
    assert orders.redeem(tokens[2], "scripted", b"order") == "plan-2"


def test_expired_orders_make_room_without_being_counted_as_dropped(orders: Confirmations, clock: Clock) -> None:
    for number in range(3):
        orders.keep("scripted", b"order", f"plan-{number}")
    clock.now_s = 20.0
    orders.keep("scripted", b"order", "new")
    assert (len(orders), orders.dropped) == (1, 0)
