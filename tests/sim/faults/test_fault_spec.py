import msgspec
import pytest

from robrain.protocol.clock import to_ns
from robrain.protocol.model.checked import convert
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultMoment, FaultSpec, FaultTimes

BAD = {
    "ends before it begins": ({"kind": "kill", "until_s": 1.0}, "expected until_s > at_s = 2"),
    "slow without a period": ({"kind": "slow"}, "expected period_s for slow"),
    "a period of a kill": ({"kind": "kill", "period_s": 1.0}, "expected period_s for slow, and for nothing else"),
    "late before it is sent": ({"kind": "delay", "late_s": (-1.0, 2.0)}, "expected late_s as"),
    "a side of a kill": ({"kind": "kill", "side": ("r2",)}, "expected side for partition alone"),
    "a full disk of a robot": ({"kind": "disk_full"}, "expected robot = 'coordinator' for disk_full, got 'r1'"),
    "drained for a while": ({"kind": "drain", "soc": 0.1, "until_s": 9.0}, "expected no until_s for drain"),
    "a battery of the coordinator": (
        {"kind": "drain", "soc": 0.1, "robot": COORDINATOR},
        "expected the name of a robot",
    ),
}


@pytest.mark.parametrize(("given", "told"), BAD.values(), ids=BAD)
def test_a_fault_that_makes_no_sense_is_refused_in_one_sentence(given, told):
    with pytest.raises(msgspec.ValidationError, match=told):
        convert({"robot": "r1", "at_s": 2.0, **given}, FaultSpec)


def changes(faults, seed=1, until_s=100.0, moments=()):
    times = FaultTimes(faults, seed)
    for moment, robot, at_s in moments:
        times.record(moment, robot, to_ns(at_s))
    found = []
    for tick in range(int(10 * until_s) + 1):
        found += [(tick / 10, one.number, one.begins) for one in times.due(to_ns(tick / 10))]
    return found


def test_a_fault_begins_and_ends_at_its_times():
    assert changes([FaultSpec(robot="r1", kind=FaultKind.HANG, at_s=2.0, until_s=5.5)]) == [
        (2.0, 0, True),
        (5.5, 0, False),
    ]


def test_a_fault_that_waits_for_an_event_begins_after_it_and_once():
    fault = FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=1.0, until_s=2.0, on=FaultMoment.TASK_DONE)
    moments = [
        (FaultMoment.TASK_DONE, "r2", 3.0),
        (FaultMoment.TASK_DONE, "r1", 7.0),
        (FaultMoment.TASK_DONE, "r1", 9.0),
    ]
    assert changes([fault], moments=moments) == [(8.0, 0, True), (9.0, 0, False)]


def test_times_that_are_left_open_are_drawn_from_the_seed():
    fault = FaultSpec(robot="r1", kind=FaultKind.HANG, at_s=2.0, until_s=3.0, within_s=20.0)
    drawn = {seed: changes([fault], seed) for seed in range(5)}
    assert drawn[0] == changes([fault], 0)
    assert len({begin for (begin, _, _), _ in drawn.values()}) == 5
    assert all(2.0 <= begin <= 22.1 for (begin, _, _), _ in drawn.values())
