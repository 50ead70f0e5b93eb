"""What a rule waits for, as people read it."""

from typing import Any

import pytest

from robrain.coordinator.rules.rule import Area, EventCondition, ReadingCondition, Rule, TaskOrder
from robrain.coordinator.rules.rule_state import RuleState, waits_for

ORDER = TaskOrder(kind="visit", place_m=(1.0, 2.0))


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        ({"above": 26.5}, "co2 above 26.5"),
        ({"below": 3, "for_s": 10}, "co2 below 3 for 10 s"),
        ({"rising_per_min": 5}, "co2 rising by more than 5 per minute"),
        ({"falling_per_min": 5, "for_s": 2.5}, "co2 falling by more than 5 per minute for 2.5 s"),
        ({"above": 1, "motes": ("m1", "m2")}, "co2 of m1, m2 above 1"),
        ({"above": 1, "robots": ("r1", "r2", "r3", "r4")}, "co2 above 1 heard by 4 robots"),
        ({"above": 1, "area": Area(0, 1, 2.5, 3)}, "co2 above 1 within x 0 to 2.5 m, y 1 to 3 m"),
    ],
)
def test_a_rule_about_readings_tells_quantity_threshold_and_where(condition: dict[str, Any], words: str) -> None:
    rule = Rule(name="air", reading=ReadingCondition(quantity="co2", **condition), task=ORDER)
    assert waits_for(rule) == f"{words}; then visit"


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        ({}, "changed of monitor"),
        ({"robots": ("r1",)}, "changed of monitor on r1"),
        ({"above": 1}, "changed of monitor with a value above 1"),
        ({"field": "share.max", "above": 1, "below": 4}, "changed of monitor with share.max above 1 and below 4"),
    ],
)
def test_a_rule_about_events_tells_plugin_event_and_value(condition: dict[str, Any], words: str) -> None:
    rule = Rule(name="seen", event=EventCondition(plugin="monitor", event="changed", **condition), task=ORDER)
    assert waits_for(rule) == f"{words}; then visit"


def test_what_a_rule_waits_for_is_published_with_what_it_has_done() -> None:
    rule = Rule(name="air", reading=ReadingCondition(quantity="co2", above=900), task=ORDER)
    assert RuleState(rule, (), (), 0).status(lambda task: True).waits == "co2 above 900; then visit"
