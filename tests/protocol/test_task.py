from pathlib import Path
from typing import get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import (
    Collect,
    Explore,
    Inspect,
    Monitor,
    Recharge,
    Relay,
    Replace,
    Sense,
    Task,
    Visit,
    kind_of,
    place_of,
)

GOLDEN = Path(__file__).parent / "golden" / "tasks"
"""One example of each kind of task, as it is on the wire. Changed bytes break older peers and journals: think first."""
PLACE = Point2D(1.5, -2.0)

EXAMPLES = [
    Visit(id="visit-1", place=PLACE, service_s=5.0, priority=2.0, earliest_ns=1_000, deadline_ns=9_000_000_000),
    Inspect(id="inspect-1", place=PLACE, look_at=Point2D(2.0, 2.0), needs=("camera",), after=("visit-1",)),
    Collect(id="collect-1", place=PLACE, mote="m3", timeout_s=30.0),
    Relay(id="relay-1", place=PLACE, mote="m3", duration_s=120.0, rssi_min_dbm=-80.0, robots=2),
    Monitor(id="monitor-1", place=PLACE, duration_s=600.0, interval_s=60.0, views=6),
    Explore(id="explore-1", goal=PLACE),
    Replace(id="replace-1", place=PLACE, mote="m3", duration_s=60.0, period_s=2.0),
    Sense(id="sense-1", place=PLACE, quantity="light_lx", mote="m3", timeout_s=10.0),
    Recharge(id="recharge-1", place=PLACE, yaw_rad=0.5, until_soc=0.8),
]
each = pytest.mark.parametrize("task", EXAMPLES, ids=kind_of)

finite = st.floats(-1e6, 1e6)
above = st.floats(0.001, 1e6)
names = st.text(min_size=1, max_size=20)
common = {
    "id": names,
    "priority": above,
    "earliest_ns": st.integers(0, 2**40),
    "deadline_ns": st.none() | st.integers(2**41, 2**62),
    "service_s": st.floats(0, 1e6),
    "needs": st.lists(names, max_size=3).map(tuple),
    "after": st.lists(names, max_size=3).map(tuple),
    "robots": st.integers(1, 9),
    "place": st.builds(Point2D, finite, finite),
}
tasks = st.one_of(
    st.builds(Visit, **common),
    st.builds(Collect, mote=names, timeout_s=above, **common),
    st.builds(Relay, mote=names, duration_s=above, rssi_min_dbm=finite, **common),
    st.builds(Monitor, duration_s=above, interval_s=above, views=st.integers(1, 16), **common),
    st.builds(Recharge, yaw_rad=st.none() | finite, until_soc=st.floats(0.01, 1.0), **common),
)


def test_every_kind_of_task_has_an_example():
    assert {type(task) for task in EXAMPLES} == set(get_args(Task))
    assert {path.stem for path in GOLDEN.glob("*.json")} == {kind_of(task) for task in EXAMPLES}


@each
def test_a_task_has_the_bytes_that_are_pinned(task):
    pinned = (GOLDEN / f"{kind_of(task)}.json").read_bytes()
    assert msgspec.json.encode(task) == pinned
    assert msgspec.json.decode(pinned, type=Task) == task


@given(tasks)
def test_what_is_encoded_decodes_as_the_same_task(task):
    assert msgspec.json.decode(msgspec.json.encode(task), type=Task) == task


def test_a_task_of_an_older_peer_decodes_and_is_encoded_as_it_was():
    older = b'{"type":"explore","id":"task-7","goal":{"x_m":1.5,"y_m":-2.0}}'
    task = msgspec.json.decode(older, type=Task)
    assert task == Explore(id="task-7", goal=Point2D(1.5, -2.0))
    assert msgspec.json.encode(task) == older


def test_a_task_of_a_newer_peer_decodes_without_what_is_new():
    newer = b'{"type":"visit","id":"t","place":{"x_m":1.0,"y_m":2.0},"mood":"good"}'
    assert msgspec.json.decode(newer, type=Task) == Visit(id="t", place=Point2D(1.0, 2.0))


@each
def test_every_task_has_a_place(task):
    assert place_of(task) == PLACE


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: Visit(id="", place=PLACE), "to have an id"),
        (lambda: Visit(id="t", place=Point2D(float("nan"), 0.0)), "a finite place"),
        (lambda: Visit(id="t", place=PLACE, priority=0.0), "priority > 0, got 0.0"),
        (lambda: Visit(id="t", place=PLACE, service_s=-1.0), "service_s >= 0, got -1.0"),
        (lambda: Visit(id="t", place=PLACE, robots=0), "robots >= 1, got 0"),
        (lambda: Visit(id="t", place=PLACE, earliest_ns=5, deadline_ns=5), "deadline_ns after earliest_ns 5, got 5"),
        (lambda: Collect(id="t", place=PLACE, mote="m1", timeout_s=0.0), "timeout_s > 0"),
        (lambda: Relay(id="t", place=PLACE, mote="m1", duration_s=float("inf")), "a finite duration_s"),
        (lambda: Relay(id="t", place=PLACE, mote="m1", duration_s=1.0, rssi_min_dbm=float("nan")), "rssi_min_dbm"),
        (lambda: Relay(id="t", place=PLACE, duration_s=1.0), "a mote or a robot to be the link to, got neither"),
        (lambda: Monitor(id="t", place=PLACE, duration_s=1.0, views=0), "views from 1 to 16, got 0"),
        (lambda: Replace(id="t", place=PLACE, mote="m1", duration_s=1.0, period_s=0.0), "period_s > 0"),
        (lambda: Sense(id="t", place=PLACE, timeout_s=-1.0), "timeout_s > 0"),
        (lambda: Recharge(id="t", place=PLACE, until_soc=1.5), "until_soc above 0 and at most 1, got 1.5"),
        (lambda: Recharge(id="t", place=PLACE, yaw_rad=float("nan")), "a finite yaw_rad"),
    ],
)
def test_a_task_that_makes_no_sense_is_refused_in_words(make, expected):
    with pytest.raises(ValueError, match=expected):
        make()
