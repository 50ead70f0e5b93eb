"""The judges together: one for each invariant, bounded memory, the same verdict from the wire."""

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.recording.invariants.invariant import KEPT_BREACHES, Invariant, InvariantState
from robrain.recording.invariants.judging import Judging, broken
from tests.recording.invariants.team_script import TeamScript, at_task, battery, truth


def test_only_the_first_breaches_are_kept_and_all_are_counted() -> None:
    script = TeamScript()
    script.truths["r1"] = {}
    for step in range(40):
        script.now_s = 0.2 * step
        script.send(truth(script.now_s, r1={"energy_j": float(100 - step)}))
    ruling = script.ruling(Invariant.ENERGY)
    assert (ruling.broken, len(ruling.breaches), ruling.more) == (39, KEPT_BREACHES, 39 - KEPT_BREACHES)
    assert ruling.state is InvariantState.BROKEN


def test_what_a_recorder_hears_is_judged_as_what_was_decoded() -> None:
    script = TeamScript()
    script.states["r1"] = {**at_task("door"), **battery(0.5)}
    script.states["r2"] = at_task("door", 2)
    script.truths["r1"] = script.truths["r2"] = {"energy_j": 3.0}
    script.pass_time(5.0)
    from_wire = Judging()
    for message, time_ns in script.messages:
        for topic in (ROBOT_STATE, ARENA_TRUTH):
            if topic.message is type(message):
                from_wire.receive([(topic, "key", msgspec.json.encode(message), 0, 0)], time_ns)
    at_one = [ruling for ruling in from_wire.finish() if ruling.invariant is Invariant.TASK_AT_ONE]
    assert at_one == [script.ruling(Invariant.TASK_AT_ONE)]
    assert broken(at_one) == 1


def test_a_payload_that_is_not_of_its_topic_is_passed_over() -> None:
    judging = Judging()
    judging.receive([(ROBOT_STATE, "key", b'{"robot": 3}', 0, 0)], to_ns(1.0))
    assert broken(judging.finish()) == 0
