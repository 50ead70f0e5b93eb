"""The examples of messages in `tests/protocol/golden`: bytes, fields, older and newer peers.

Changed bytes break older peers, journals and recordings: think first.
"""

import inspect
from pathlib import Path

import msgspec
import pytest

from robrain.protocol import errors
from robrain.protocol.messages import message
from robrain.protocol.messages.robots import plugin_messages, robot_messages
from robrain.protocol.messages.tasks import mission_messages, plan_messages, rule_messages, task_messages
from robrain.protocol.model.geometry import Point2D
from tests.message_modules import message_modules

GOLDEN = Path(__file__).parents[0] / "golden"


def structs_of(module):
    """Structs that a module defines."""
    found = (kind for _, kind in inspect.getmembers(module, inspect.isclass) if issubclass(kind, msgspec.Struct))
    return {kind for kind in found if kind.__module__ == module.__name__}


TRAVELLING = {errors.ErrorReply} | {
    kind
    for module in message_modules()
    if module is not plan_messages
    for _, kind in inspect.getmembers(module, inspect.isclass)
    if issubclass(kind, message.Message) and kind.__module__ != message.__name__  # which has the bases
}
KINDS = {
    ".": TRAVELLING,
    "task_requests": structs_of(task_messages),
    "plans": structs_of(plan_messages),
    "missions": structs_of(mission_messages) | structs_of(rule_messages),
}
STRICT = (rule_messages.RuleChange, rule_messages.RuleTable)
"""They have rules, of which an unknown field is refused."""
FREE = (
    plugin_messages.PluginEvent,
    plugin_messages.PluginInfo,
    task_messages.KnownKind,
    mission_messages.MissionStart,
)
"""They have free JSON."""
BY_NAME = {
    kind.__name__: kind
    for module in (*message_modules(), errors)
    for _, kind in inspect.getmembers(module, inspect.isclass)
    if issubclass(kind, msgspec.Struct)
}
each = pytest.mark.parametrize(
    ("kind", "path"),
    [
        pytest.param(BY_NAME[path.stem], path, id=path.stem)
        for folder in KINDS
        for path in sorted((GOLDEN / folder).glob("*.json"))
    ],
)


def with_unknown_fields(value):
    if isinstance(value, dict):
        # A task's result and the values of a reason are free: they keep what they are given.
        known = {name: with_unknown_fields(field) for name, field in value.items() if name not in ("result", "values")}
        return {"from_a_newer_peer": [1], **value, **known}
    if isinstance(value, list):
        return [with_unknown_fields(item) for item in value]
    return value


@each
def test_a_message_is_read_from_its_golden_file_and_written_in_the_same_bytes(kind, path):
    assert msgspec.json.encode(msgspec.json.decode(path.read_bytes(), type=kind)) == path.read_bytes()


@each
def test_an_example_says_something_in_every_field(kind, path):
    assert set(msgspec.json.decode(path.read_bytes())) - {"type"} == set(kind.__struct_fields__)


@each
def test_unknown_fields_of_newer_peers_are_ignored(kind, path):
    if kind in STRICT:
        return
    newer = msgspec.json.encode(with_unknown_fields(msgspec.json.decode(path.read_bytes())))
    decoded = msgspec.json.decode(newer, type=kind)
    if kind not in FREE:
        assert decoded == msgspec.json.decode(path.read_bytes(), type=kind)


@each
def test_fields_that_an_older_peer_leaves_out_have_their_defaults(kind, path):
    fields = msgspec.structs.fields(kind)
    required = {field.encode_name for field in fields if field.required}
    full = msgspec.json.decode(path.read_bytes())
    older = {name: value for name, value in full.items() if name in required}
    decoded = msgspec.json.decode(msgspec.json.encode(older), type=kind)
    whole = msgspec.json.decode(path.read_bytes(), type=kind)
    for field in fields:
        if field.required:
            assert getattr(decoded, field.name) == getattr(whole, field.name)
        elif field.default is not msgspec.NODEFAULT:
            assert getattr(decoded, field.name) == field.default
        else:
            assert getattr(decoded, field.name) == field.default_factory()


@pytest.mark.parametrize("folder", KINDS)
def test_every_message_that_travels_has_an_example(folder):
    names = {path.stem for path in (GOLDEN / folder).glob("*.json")}
    assert {kind.__name__ for kind in KINDS[folder]} <= names
    if folder != ".":  # the other folder has answers too
        assert names == {kind.__name__ for kind in KINDS[folder]}


def test_what_is_computed_from_a_shared_message_is_computed_once_and_does_not_travel() -> None:
    path = robot_messages.PlannedPath(robot="r1", points=[Point2D(1.0, 2.0)])
    seen = []

    def count(one: robot_messages.PlannedPath) -> int:
        seen.append(one)
        return len(one.points)

    before = msgspec.json.encode(path)
    assert [path.derived(count), path.derived(count)] == [1, 1]
    assert seen == [path]
    assert msgspec.json.encode(path) == before
    longer = msgspec.structs.replace(path, points=[*path.points, Point2D(3.0, 2.0)])
    assert longer.derived(count) == 2, "a changed copy keeps nothing of it"
