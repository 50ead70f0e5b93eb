from pathlib import Path

import msgspec
import pytest
from hypothesis import strategies as st

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.old_form import upgraded, upgraded_json
from robrain.protocol.model.tasks.stock_kinds import (
    STOCK_KINDS,
    Collect,
    Deliver,
    Follow,
    Guard,
    Inspect,
    Item,
    Monitor,
    Patrol,
    Recharge,
    Relay,
    Replace,
    Seek,
    Sense,
    Sweep,
    check_parameters,
)
from robrain.protocol.model.tasks.task import BadParameters, Task

GOLDEN = Path(__file__).parents[1] / "golden" / "tasks"
"""One example of each kind of task, as it is on the wire. Changed bytes break older peers and journals: think first."""
OLD = Path(__file__).parents[1] / "golden" / "old_tasks"
"""The same tasks as they were written when each kind was a struct of its own."""
PLACE = Point2D(1.5, -2.0)
AREA = [Point2D(0.0, 0.0), Point2D(4.0, 0.0), Point2D(4.0, 3.0)]


def task(kind, parameters=None, **fields):
    given_parameters = {} if parameters is None else parameters.json
    return Task(id=f"{kind}-1", kind=kind, place=PLACE, parameters=given_parameters, **fields)


EXAMPLES = [
    task("visit", service_s=5.0, priority=2.0, earliest_ns=1_000, deadline_ns=9_000_000_000),
    task("inspect", Inspect(look_at=Point2D(2.0, 2.0)), needs=("camera",), after=("visit-1",)),
    task("collect", Collect(mote="m3", timeout_s=30.0)),
    task("patrol", Patrol(stops=[Point2D(3.0, 1.0)], rounds=2, pause_s=5.0)),
    task("deliver", Deliver(to=PLACE, payload_kg=2.5, items=[Item(pick_up=Point2D(3.0, 1.0), to=Point2D(1.0, 1.0))])),
    task("sweep", Sweep(area=AREA, width_m=0.5)),
    task("follow", Follow(robot="r2", duration_s=60.0, distance_m=2.0)),
    task("guard", Guard(area=AREA, duration_s=60.0, interval_s=10.0, views=2)),
    task("relay", Relay(mote="m3", duration_s=120.0, rssi_min_dbm=-80.0), robots=2),
    task("monitor", Monitor(duration_s=600.0, interval_s=60.0, views=6)),
    task("explore"),
    task("replace", Replace(mote="m3", duration_s=60.0, period_s=2.0)),
    task("sense", Sense(quantity="light_lx", mote="m3", timeout_s=10.0)),
    task("seek", Seek(quantity="light_lx", duration_s=90.0, reach_m=8.0), same_robot_as="visit-1"),
    task("recharge", Recharge(yaw_rad=0.5, until_soc=0.8)),
]
NEVER_OLD = {"patrol", "seek", "deliver", "sweep", "follow", "guard"}
"""Kinds that are younger than the form of today."""
each = pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.kind)

finite = st.floats(-1e6, 1e6)
above = st.floats(0.001, 1e6)
names = st.text(min_size=1, max_size=20)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | finite | names,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3),
    max_leaves=8,
)
tasks = st.builds(
    Task,
    id=names,
    kind=names,
    priority=above,
    earliest_ns=st.integers(0, 2**40),
    deadline_ns=st.none() | st.integers(2**41, 2**62),
    service_s=st.floats(0, 1e6),
    needs=st.lists(names, max_size=3).map(tuple),
    after=st.lists(names, max_size=3).map(tuple),
    robots=st.integers(1, 9),
    place=st.builds(Point2D, finite, finite),
    parameters=st.dictionaries(names, json_values, max_size=4),
)
parameters = st.one_of(
    st.builds(Collect, mote=names, timeout_s=above),
    st.builds(Relay, mote=names, duration_s=above, rssi_min_dbm=finite),
    st.builds(Monitor, duration_s=above, interval_s=above, views=st.integers(1, 16)),
    st.builds(Recharge, yaw_rad=st.none() | finite, until_soc=st.floats(0.01, 1.0)),
)


def test_every_stock_kind_has_an_example():
    assert {example.kind for example in EXAMPLES} == set(STOCK_KINDS)
    assert {path.stem for path in GOLDEN.glob("*.json")} == set(STOCK_KINDS)
    assert {path.stem for path in OLD.glob("*.json")} == set(STOCK_KINDS) - NEVER_OLD


@each
def test_a_task_has_the_bytes_that_are_pinned(example):
    pinned = (GOLDEN / f"{example.kind}.json").read_bytes()
    assert msgspec.json.encode(example) == pinned
    assert msgspec.json.decode(pinned, type=Task) == example


@pytest.mark.parametrize("example", [one for one in EXAMPLES if one.kind not in NEVER_OLD], ids=lambda one: one.kind)
def test_a_task_of_the_old_form_is_read_as_the_same_task(example):
    old = b'{"task":' + (OLD / f"{example.kind}.json").read_bytes() + b',"robot":"r1"}'
    content = msgspec.json.decode(upgraded_json(old))
    assert msgspec.convert(content["task"], Task) == example
    assert content["robot"] == "r1"
    check_parameters(msgspec.convert(content["task"], Task))


@pytest.mark.parametrize(
    "payload",
    [
        b'{"task":{"id":"t","kind":"visit","place":{"x_m":1.0,"y_m":2.0}}}',
        b'{"task":{"type":"dance","id":"t"}}',
        b'{"task":{"type":"visit",',
        b'{"task":{"type":' + b"[" * 100_000,
        b'"task"',
        b"",
    ],
)
def test_what_is_no_task_of_the_old_form_is_left_as_it_is(payload):
    assert upgraded_json(payload)[:80] in (payload[:80], payload.replace(b" ", b"")[:80])
    assert upgraded(["task"]) == ["task"]


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"id": ""}, "id of length at least 1"),
        ({"kind": ""}, "kind of length at least 1"),
        ({"place": Point2D(float("nan"), 0.0)}, "a finite place"),
        ({"priority": 0.0}, "priority > 0, got 0.0"),
        ({"service_s": -1.0}, "service_s >= 0, got -1.0"),
        ({"robots": 0}, "robots >= 1, got 0"),
        ({"same_robot_as": "t0", "robots": 2}, "one robot with same_robot_as, got robots 2"),
        ({"earliest_ns": 5, "deadline_ns": 5}, "deadline_ns after earliest_ns 5, got 5"),
    ],
)
def test_a_task_that_makes_no_sense_is_refused_in_words(fields, expected):
    with pytest.raises(ValueError, match=expected):
        Task(**{"id": "t", "kind": "visit", "place": PLACE, **fields})


@pytest.mark.parametrize(
    ("kind", "given_parameters", "field", "expected"),
    [
        ("collect", {"mote": "m1", "timeout_s": 0.0}, "timeout_s", "timeout_s: Expected `float` > 0.0"),
        ("collect", {}, "mote", "a task to collect needs mote"),
        ("relay", {"mote": "m1", "duration_s": 1e7}, "duration_s", "duration_s: Expected `float` <= 1000000.0"),
        ("relay", {"duration_s": 1.0}, "", "a mote or a robot to be the link to, got neither"),
        ("monitor", {"duration_s": 1.0, "views": 0}, "views", "views: Expected `int` >= 1"),
        ("replace", {"mote": "m1", "duration_s": 1.0, "period_s": 0.0}, "period_s", "period_s: Expected `float` > 0.0"),
        ("sense", {"timeout_s": -1.0}, "timeout_s", "timeout_s: Expected `float` > 0.0"),
        ("recharge", {"until_soc": 1.5}, "until_soc", "until_soc: Expected `float` <= 1.0"),
        ("recharge", {"yaw_rad": "north"}, "yaw_rad", "yaw_rad: Expected `float | null`, got `str`"),
        ("inspect", {"look_at": {"x_m": 1.0}}, "look_at.y_m", "a task to inspect needs look_at.y_m"),
        ("visit", {"mood": "good"}, "mood", "mood: a task to visit has no such parameter, but none"),
        ("collect", {"mote": "m1", "mood": 1}, "mood", "has no such parameter, but mote, timeout_s"),
    ],
)
def test_parameters_that_make_no_sense_are_refused_in_words(kind, given_parameters, field, expected):
    with pytest.raises(BadParameters) as refused:
        check_parameters(Task(id="t", kind=kind, place=PLACE, parameters=given_parameters))
    assert expected in str(refused.value)
    assert (refused.value.kind, refused.value.field) == (kind, field)
