from robrain.protocol.clock import to_ns
from robrain.sim.faults.fault_spec import FaultKind, FaultMoment, FaultSpec, FaultTimes


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
