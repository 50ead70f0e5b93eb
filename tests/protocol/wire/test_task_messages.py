"""What is said about tasks and about plans, byte by byte."""

import inspect
from pathlib import Path

import msgspec
import pytest

from robrain.protocol.wire.messages.tasks import plan_messages, task_messages
from tests.protocol import plan_examples, task_examples

GOLDEN = Path(__file__).parents[1] / "golden"
SAID = {"task_requests": (task_messages, task_examples.EXAMPLES), "plans": (plan_messages, plan_examples.EXAMPLES)}
each = pytest.mark.parametrize(
    ("message", "bytes_of"),
    [
        pytest.param(message, GOLDEN / about / f"{type(message).__name__}.json", id=type(message).__name__)
        for about, (_, examples) in SAID.items()
        for message in examples
    ],
)


@each
def test_the_bytes_are_those_of_the_golden_file_and_decode_to_the_same(message, bytes_of):
    assert msgspec.json.encode(message) == bytes_of.read_bytes()
    assert msgspec.json.decode(bytes_of.read_bytes(), type=type(message)) == message


@each
def test_an_example_says_something_in_every_field(message, bytes_of):
    assert set(msgspec.json.decode(bytes_of.read_bytes())) == set(type(message).__struct_fields__)


@each
def test_older_peers_may_leave_out_what_has_a_default_and_newer_ones_say_more(message, bytes_of):
    required = {field.encode_name for field in msgspec.structs.fields(type(message)) if field.required}
    full = msgspec.json.decode(bytes_of.read_bytes())
    older = {name: value for name, value in full.items() if name in required}
    decoded = msgspec.json.decode(msgspec.json.encode({**older, "from_a_newer_peer": 1}), type=type(message))
    assert all(getattr(decoded, name) == getattr(message, name) for name in required)


@pytest.mark.parametrize("about", SAID)
def test_everything_that_is_said_has_an_example(about):
    module, examples = SAID[about]
    structs = {kind for _, kind in inspect.getmembers(module, inspect.isclass)
               if issubclass(kind, msgspec.Struct) and kind.__module__ == module.__name__}  # fmt: skip
    assert structs == {type(message) for message in examples}
    assert {path.stem for path in (GOLDEN / about).glob("*.json")} == {kind.__name__ for kind in structs}
