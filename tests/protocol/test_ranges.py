"""Every number, text and list of a message has a range that the code behind the inbox can handle."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskOffer
from robrain.protocol.model.checked import Checked, convert
from robrain.protocol.model.ranges import EPOCH_MAX, TEXT_MAX, Positive, cut
from robrain.protocol.model.tasks.task import Task
from tests.message_modules import message_modules

GOLDEN = Path(__file__).parent / "golden"
FREE = {"result", "value", "parameters", "returns", "signature", "doc", "cells", "payload", "question", "text"}
"""Fields that may hold any JSON, text of a plugin's author, bytes, or a command line."""
LONG = {("HaltRequest", "reason"): 1_000_000}
"""Longer limits than `TEXT_MAX`. A halt with a long reason is accepted, and the reason is cut."""
NUMBERS = [1e308, -1e308, 10**30, 2**63]
CASES = sorted(
    path for path in GOLDEN.rglob("*.json") if path.stem not in ("ErrorReply",) and path.parent.name != "old_tasks"
)


def kind_of(path) -> Any:
    if path.parent.name == "tasks":
        return Task
    return next(found for one in message_modules() if (found := getattr(one, path.stem, None)))


def leaves(value: Any, where: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        if key not in FREE:
            yield (*where, key), part
            yield from leaves(part, (*where, key))


def with_value(whole: Any, where: tuple[str | int, ...], value: Any) -> bytes:
    whole = json.loads(json.dumps(whole))
    target = whole
    for key in where[:-1]:
        target = target[key]
    target[where[-1]] = value
    return json.dumps(whole).encode()


def is_refused(encoded: bytes, kind: Any) -> bool:
    try:
        msgspec.json.decode(encoded, type=kind)
    except msgspec.DecodeError:
        return True
    return False


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_number_in_a_message_has_a_range(path) -> None:
    whole = json.loads(path.read_bytes())
    for where, value in leaves(whole):
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        for number in NUMBERS:
            assert is_refused(with_value(whole, where, number), kind_of(path)), f"{where} may be {number}"


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_text_in_a_message_has_a_length_limit(path) -> None:
    whole = json.loads(path.read_bytes())
    for where, value in leaves(whole):
        if isinstance(value, str):
            limit = LONG.get((path.stem, where[-1]), TEXT_MAX)
            assert is_refused(with_value(whole, where, "x" * (limit + 1)), kind_of(path)), f"{where} may be any text"


@pytest.mark.parametrize("length", [1, 3, 8, 10])
def test_a_covariance_has_nine_numbers_or_none(length) -> None:
    said = json.dumps({"robot": "r1", "pose_covariance": [0.0] * length}).encode()
    with pytest.raises(msgspec.ValidationError, match="9"):
        msgspec.json.decode(said, type=RobotState)


def test_an_epoch_is_a_number_that_every_peer_can_hold() -> None:
    said = b'{"task":{"id":"t","kind":"visit","place":{"x_m":0,"y_m":0}},"lease_s":1,"epoch":%d}'
    assert msgspec.json.decode(said % EPOCH_MAX, type=TaskOffer).epoch == 2**53 - 1
    for epoch in (EPOCH_MAX + 1, -1, 10**25):
        with pytest.raises(msgspec.ValidationError, match="epoch"):
            msgspec.json.decode(said % epoch, type=TaskOffer)


def test_a_text_that_is_cut_fits() -> None:
    assert cut("x" * 5000) == "x" * 1023 + "…"
    assert cut("short") == "short"


class _Limits(Checked, frozen=True):
    speed_m_s: Positive


class _File(Checked, frozen=True):
    driver: _Limits | None = None
    robots: dict[str, _Limits] = msgspec.field(default_factory=dict)


@pytest.mark.parametrize(
    ("document", "match"),
    [
        ({"driver": {"speed_m_s": -1}}, r"expected speed_m_s > 0, got -1 - at `\$\.driver`"),
        ({"robots": {"r1": {"speed_m_s": -1}}}, "speed_m_s"),
    ],
)
def test_a_number_of_a_file_that_is_out_of_range_is_named_with_its_place(document, match) -> None:
    with pytest.raises(msgspec.ValidationError, match=match):
        convert(document, _File)
