import inspect
from pathlib import Path

import msgspec
import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.objective import Objective
from robrain.protocol.wire import plan_messages
from robrain.protocol.wire.task_messages import RobotVerdict

GOLDEN = Path(__file__).parent / "golden" / "plans"
"""One example of each, as it is on the wire and in recordings. Changed bytes break both: think first."""

EXAMPLES = [
    plan_messages.TaskDecision(
        stamp_ns=1_500_000_000,
        seq=3,
        task="task-7",
        plan=12,
        robots=("r1",),
        start_in_s=4.5,
        why="r1 takes least; the next would take 80 J",
        bids=(
            RobotVerdict(robot="r1", chosen=True, energy_j=61.2, time_s=4.5),
            RobotVerdict(robot="r2", why_not="would leave 3 % < 10 % reserve"),
        ),
    ),
    plan_messages.PlanProblem(
        stamp_ns=1_500_000_000,
        seq=4,
        plan=12,
        asked_ns=1_490_000_000,
        objective=Objective.MAKESPAN,
        method="optimal",
        seed=1,
        rounds=2,
        iterations=50,
        gain_min=0.02,
        question=b"\x00\x01",
        warm_start=(("r1", ("task-7",)),),
        routes=(("r1", ("task-7", "task-8")),),
        cause="task-8 is queued",
    ),
    plan_messages.ObjectiveRequest(objective=Objective.LIFETIME, by="ann"),
    plan_messages.PlanningStatus(
        objective=Objective.ENERGY, method="optimal", plans=12, planned=3, left_out=1, took_s=0.25,
        chargers=(Point2D(2.0, 1.5),),
    ),
]  # fmt: skip
each = pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)


def golden(message):
    return (GOLDEN / f"{type(message).__name__}.json").read_bytes()


@each
def test_the_bytes_are_those_of_the_golden_file_and_decode_to_the_same(message):
    assert msgspec.json.encode(message) == golden(message)
    assert msgspec.json.decode(golden(message), type=type(message)) == message


@each
def test_an_example_says_something_in_every_field(message):
    assert set(msgspec.json.decode(golden(message))) == set(type(message).__struct_fields__)


@each
def test_older_peers_may_leave_out_what_has_a_default_and_newer_ones_say_more(message):
    required = {field.encode_name for field in msgspec.structs.fields(type(message)) if field.required}
    full = msgspec.json.decode(golden(message))
    older = {name: value for name, value in full.items() if name in required}
    decoded = msgspec.json.decode(msgspec.json.encode({**older, "from_a_newer_peer": 1}), type=type(message))
    assert all(getattr(decoded, name) == getattr(message, name) for name in required)


def test_everything_that_is_said_about_plans_has_an_example():
    structs = {kind for _, kind in inspect.getmembers(plan_messages, inspect.isclass)
               if issubclass(kind, msgspec.Struct) and kind.__module__ == plan_messages.__name__}  # fmt: skip
    assert structs == {type(message) for message in EXAMPLES}
    assert {path.stem for path in GOLDEN.glob("*.json")} == {kind.__name__ for kind in structs}
