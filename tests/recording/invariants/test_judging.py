"""The judges together: one for each invariant, sentences for all, memory that does not grow with the run."""

import typing

import msgspec
import pytest

from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.table.topics import ARENA_TRUTH, ROBOT_STATE
from robrain.recording.invariants import findings
from robrain.recording.invariants.findings import (
    CASES,
    INVARIANTS,
    AnyFinding,
    Breach,
    Invariant,
    InvariantState,
    MissingEvidence,
    Violation,
    breach_text,
    cases_text,
    missing_text,
)
from robrain.recording.invariants.invariant_judge import KEPT_BREACHES
from robrain.recording.invariants.judging import JUDGES, Judging, broken
from tests.recording.invariants.told import Told, at_task, battery, truth

SAMPLES = {str: "r1", int: 2, float: 1.5, bool: True, TaskState: TaskState.DONE, Point2D: Point2D(1.0, 2.0)}


def sample(type_: object) -> object:
    """A value of a field."""
    if type_ in SAMPLES:
        return SAMPLES[type_]  # type: ignore[index]
    arguments = typing.get_args(type_)
    if typing.get_origin(type_) is tuple:
        return tuple(sample(one) for one in arguments if one is not Ellipsis)
    return sample(arguments[0])


def test_there_is_one_judge_for_each_invariant_and_words_for_all() -> None:
    assert [judge.invariant for judge in JUDGES] == list(Invariant)
    assert set(INVARIANTS) == set(CASES) == set(Invariant)
    assert all(missing_text(missing) for missing in MissingEvidence)
    assert cases_text(Invariant.WALLS, 1) == "1 pose"
    assert cases_text(Invariant.WALLS, 3) == "3 poses"


@pytest.mark.parametrize("type_", typing.get_args(AnyFinding), ids=lambda type_: type_.__name__)
def test_every_finding_has_a_sentence_and_survives_json(type_: type[Violation]) -> None:
    hints = typing.get_type_hints(type_)
    finding = type_(**{name: sample(hints[name]) for name in type_.__struct_fields__})
    text = breach_text(3.0, finding)  # type: ignore[arg-type]
    assert text.startswith("at 3 s ")
    assert "r1" in text
    breach = Breach(time_s=3.0, finding=finding, text=text)  # type: ignore[arg-type]
    assert msgspec.json.decode(msgspec.json.encode(breach), type=Breach) == breach


def test_every_finding_is_one_of_those_that_can_be_told() -> None:
    structs = {each for each in vars(findings).values() if isinstance(each, type) and issubclass(each, Violation)} - {
        Violation
    }
    assert structs == set(typing.get_args(AnyFinding))


def test_only_the_first_breaches_are_kept_and_all_are_counted() -> None:
    told = Told()
    told.truths["r1"] = {}
    for step in range(40):
        told.now_s = 0.2 * step
        told.say(truth(told.now_s, r1={"energy_j": float(100 - step)}))
    ruling = told.ruling(Invariant.ENERGY)
    assert (ruling.broken, len(ruling.breaches), ruling.more) == (39, KEPT_BREACHES, 39 - KEPT_BREACHES)
    assert ruling.standing is InvariantState.BROKEN


def test_what_a_recorder_hears_is_judged_as_what_was_decoded() -> None:
    told = Told()
    told.states["r1"] = {**at_task("door"), **battery(0.5)}
    told.states["r2"] = at_task("door", 2)
    told.truths["r1"] = told.truths["r2"] = {"energy_j": 3.0}
    told.pass_time(5.0)
    from_wire = Judging()
    for message, time_ns in told.messages:
        for topic in (ROBOT_STATE, ARENA_TRUTH):
            if topic.message is type(message):
                from_wire.receive([(topic, "key", msgspec.json.encode(message), 0, 0)], time_ns)
    at_one = [ruling for ruling in from_wire.finish() if ruling.invariant is Invariant.TASK_AT_ONE]
    assert at_one == [told.ruling(Invariant.TASK_AT_ONE)]
    assert broken(at_one) == 1


def test_a_payload_that_is_not_of_its_topic_is_passed_over() -> None:
    judging = Judging()
    judging.receive([(ROBOT_STATE, "key", b'{"robot": 3}', 0, 0)], to_ns(1.0))
    assert broken(judging.finish()) == 0


def test_times_count_from_the_start_of_the_run() -> None:
    judging = Judging(start_ns=to_ns(1000.0))
    judging.handle(truth(0.0, r1={"energy_j": 5.0}), to_ns(1001.0))
    judging.handle(truth(0.2, r1={"energy_j": 4.0}), to_ns(1001.25))
    [breach] = [breach for ruling in judging.finish() for breach in ruling.breaches]
    assert breach.time_s == 1.25
    assert breach.text.startswith("at 1.25 s ")
