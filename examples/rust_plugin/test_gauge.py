"""Tests the Rust plugin from its robot's side; `make test-rust` builds and runs it."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import pytest

from robrain import CallError, ErrorCode, NobodyThere
from robrain.testing import ForeignBench

TARGET = Path(os.environ.get("CARGO_TARGET_DIR", Path(__file__).parents[2] / ".cache" / "rust-target"))
COMMAND = [TARGET / "release" / "gauge", "r1"]


class GaugeInterface(Protocol):
    def read(self) -> float: ...

    def add(self, a: int, b: int) -> int: ...


@pytest.fixture(scope="module")
def gauge() -> Iterator[ForeignBench]:
    with ForeignBench(COMMAND, plugin="gauge") as bench:
        yield bench


def test_it_is_listed_with_its_functions_and_their_types(gauge):
    info = gauge.info()
    assert (info.name, info.level, info.state, info.visibility) == ("gauge", "device", "active", ["command", "*"])
    functions = {function.name: function for function in info.functions}
    assert functions["read"].returns == {"type": "number"}
    assert functions["add"].parameters["required"] == ["a", "b"]
    assert functions["add"].signature == "(a: int, b: int) -> int"


def test_it_is_called_from_outside(gauge):
    assert 19.0 <= gauge.call("read") <= 21.0
    assert gauge.call("add", [2, 3]) == 5
    assert gauge.call("add", {"b": 2, "a": -3}) == -1


def test_it_is_called_from_inside_by_an_interface(gauge):
    handle = gauge.use(GaugeInterface)
    assert isinstance(handle.read(), float)
    assert handle.add(2, b=40) == 42


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([1], "argument b is missing"),
        ([1, "two"], 'argument b: expected an integer, got "two"'),
        ([1, 2.5], "argument b: expected an integer, got 2.5"),
        ([1, 2, 3], "takes 2 arguments, got 3"),
        ({"a": 1, "c": 2}, "no argument c"),
        (7, "expected an array or an object"),
        ([2**63 - 1, 1], "is too large"),
    ],
)
def test_bad_arguments_are_named(gauge, arguments, text):
    with pytest.raises(CallError) as caught:
        gauge.call("add", arguments)
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS
    assert text in caught.value.message


def test_what_is_no_json_is_a_bad_argument(gauge):
    with pytest.raises(CallError) as caught:
        gauge.call("add", b"[1, \xff")
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS


def test_a_function_that_it_has_not_is_its_own_error_too(gauge):
    with pytest.raises(CallError, match="gauge has no function wipe; it has: read, add") as caught:
        gauge.call_directly("wipe")
    assert caught.value.code is ErrorCode.UNKNOWN_FUNCTION


def test_it_is_gone_when_it_is_killed():
    with ForeignBench(COMMAND, plugin="gauge") as gauge:
        gauge.kill()
        with pytest.raises(NobodyThere):
            gauge.call_directly("read")
