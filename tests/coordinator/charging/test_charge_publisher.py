"""The schedule of chargers is published again when it has changed, not because time passes."""

import msgspec
import pytest

from robrain.coordinator.charging.charging import MOVED_NS, MOVED_SHARE, _is_the_same
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.plan_messages import PlannedCharge
from robrain.protocol.model.geometry import Point2D

UNTIL_NS = to_ns(60.0)
SAID = PlannedCharge(
    robot="r1", charger=Point2D(1.0, 2.0), set_out_ns=0, from_ns=0, until_ns=UNTIL_NS, soc=0.3, to_soc=0.9, behind="r2"
)


@pytest.mark.parametrize(
    "fields",
    [
        {"robot": "r3"},
        {"charger": Point2D(1.0, 3.0)},
        {"behind": ""},
        {"has_set_out": True},
        {"is_there": True},
        {"until_ns": UNTIL_NS + MOVED_NS + 1},
        {"until_ns": UNTIL_NS - MOVED_NS - 1},
    ],
    ids=str,
)
def test_a_change_is_said(fields):
    assert not _is_the_same((SAID,), (msgspec.structs.replace(SAID, **fields),), 0)


@pytest.mark.parametrize("fields", [{}, {"soc": 0.4}, {"until_ns": UNTIL_NS + MOVED_NS}, {"from_ns": 5}], ids=str)
def test_the_passing_of_time_is_not_said(fields):
    assert _is_the_same((SAID,), (msgspec.structs.replace(SAID, **fields),), 0)


def test_an_end_that_is_far_may_move_by_a_share_of_the_time_until_then():
    far = msgspec.structs.replace(SAID, until_ns=to_ns(1000.0))
    within = msgspec.structs.replace(far, until_ns=far.until_ns + round(MOVED_SHARE * far.until_ns))
    assert _is_the_same((far,), (within,), 0)
    assert not _is_the_same((far,), (msgspec.structs.replace(within, until_ns=within.until_ns + 1),), 0)


def test_one_more_or_one_less_is_said():
    assert not _is_the_same((SAID,), (), 0)
    assert not _is_the_same((), (SAID,), 0)
    assert _is_the_same((), (), 0)
