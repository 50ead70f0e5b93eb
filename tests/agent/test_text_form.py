import contextlib
import enum
import json
import uuid
from typing import Annotated, Any, Literal, NewType

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.agent.host.command_door import Question, TextCall, parse_call, parse_command
from robrain.agent.text_form import encode_own, parse_value, print_value, register_text_form
from robrain.protocol.errors import CallError, ErrorCode
from tests.agent.conftest import refused


class Complex:
    """The paper's figure 7."""

    def __init__(self, re: int, im: int) -> None:
        self.re = re
        self.im = im

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Complex) and (self.re, self.im) == (other.re, other.im)

    __hash__ = None

    @staticmethod
    def parse(text: str) -> "Complex":
        re, im = text.strip("()").split(",")
        return Complex(int(re), int(im))

    def __str__(self) -> str:
        return f"({self.re}, {self.im})"


register_text_form(Complex, Complex.parse, str)


class Gear(enum.StrEnum):
    SLOW = "slow"
    FAST = "fast"


class Level(enum.IntEnum):
    LOW = 1
    HIGH = 2


class Place(msgspec.Struct):
    x_m: float
    name: str = ""
    value: Complex | None = None


Metres = NewType("Metres", float)
SUPPORTED: list[tuple[Any, st.SearchStrategy[Any]]] = [
    (int, st.integers()),
    (float, st.floats(allow_nan=False)),
    (bool, st.booleans()),
    (str, st.text()),
    (type(None), st.none()),
    (Gear, st.sampled_from(Gear)),
    (Level, st.sampled_from(Level)),
    (Literal["a b", "null", 3], st.sampled_from(["a b", "null", 3])),
    (float | bool, st.booleans() | st.floats(allow_nan=False)),
    (bytes, st.binary()),
    (uuid.UUID, st.uuids()),
    (Metres, st.floats(allow_nan=False)),
    (list[int], st.lists(st.integers(-(2**63), 2**63))),
    (dict[str, float], st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False))),
    (Complex, st.builds(Complex, st.integers(), st.integers())),
    (list[Complex], st.lists(st.builds(Complex, st.integers(), st.integers()))),
    (
        Place,
        st.builds(
            Place,
            st.floats(allow_nan=False, allow_infinity=False),
            st.text(),
            st.none() | st.builds(Complex, st.integers(), st.integers()),
        ),
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("hint", "values"), SUPPORTED, ids=lambda value: str(value)[:20])
def test_what_is_printed_is_read_as_the_same_value_again(hint, values):
    @given(values)
    def check(value):
        text = print_value(value)
        assert "\n" not in text
        assert parse_value(text, hint) == value

    check()


@pytest.mark.parametrize(
    ("text", "hint", "value"),
    [
        (" 7 ", int, 7),  # blanks around
        ("True", bool, True),  # as Python writes it
        ("hello you", str, "hello you"),  # bare
        ('"hello, \\"you\\""', str, 'hello, "you"'),  # quoted as in JSON
        ("'say \"hi\"'", str, 'say "hi"'),  # in single quotes, as it stands
        ("''", str, ""),
        ("slow", Gear, Gear.SLOW),  # by value
        ("SLOW", Gear, Gear.SLOW),  # by name
        ("HIGH", Level, Level.HIGH),
        ("5", int | str, 5),  # what it spells
        ('"5"', int | str, "5"),  # quotes say that text is meant
        ('{"x_m": 1}', Place, Place(1.0)),
        ('{"x_m": 1, "value": "(1, 2)"}', Place, Place(1.0, "", Complex(1, 2))),  # one's own type within JSON
        ("(1, 2)", Complex | None, Complex(1, 2)),
        ("just words", Any, "just words"),
    ],
)
def test_text_means_what_the_type_hint_expects(text, hint, value):
    found = parse_value(text, hint)
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "hint", "complaint"),
    [
        ("seven", int, "expected a whole number, got 'seven'"),
        ("1_000", int, "expected a whole number"),  # Python's own habit
        ("٣", int, "expected a whole number"),  # digits that few can type
        ("fast", float, "expected a number, got 'fast'"),
        ("yes", bool, "expected true or false, got 'yes'"),
        ('"open', str, "expected one text between double quotes"),
        ('"\\ud800"', str, "surrogates not allowed"),
        ("middle", Gear, "expected one of slow, fast, got 'middle'"),
        ("-1", Annotated[int, msgspec.Meta(ge=0)], ">= 0"),
        ("[1,", list[int], "expected a list[int] as JSON"),
        ("[" * 100_000, list[Any], "as JSON"),  # nested too deep
        ("(1)", Complex, "expected a Complex, got '(1)'"),
        ('{"x_m": 1, "value": 3}', Place, "expected text, got int"),
        ("x", int | float, "expected a whole number, got 'x'; or expected a number, got 'x'"),
        ("9" * 5000, int, "9999"),  # more digits than Python takes
    ],
    ids=lambda value: str(value)[:20],
)
def test_text_that_means_nothing_is_refused_in_words(text, hint, complaint):
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 - its text is checked
        parse_value(text, hint)
    assert complaint in str(refusal.value)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.text(), st.sampled_from([hint for hint, _ in SUPPORTED]))
def test_any_text_is_a_value_or_a_value_error(text, hint):
    with contextlib.suppress(ValueError):
        parse_value(text, hint)


def test_a_struct_may_have_a_text_form_beside_its_json():
    class Point(msgspec.Struct):
        x: int
        y: int

    register_text_form(Point, lambda text: Point(*map(int, text.split("/"))), lambda point: f"{point.x}/{point.y}")
    assert print_value(parse_value("1/2", Point)) == "1/2"
    assert msgspec.json.encode(Point(1, 2), enc_hook=encode_own) == b'{"x":1,"y":2}'


def test_a_type_that_takes_no_attributes_can_be_registered_too():
    register_text_form(complex, complex, str)
    assert parse_value(print_value(1 + 2j), complex) == 1 + 2j


def test_forms_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="int has a text form that cannot be replaced"):
        register_text_form(int, int, str)


def test_a_type_without_a_form_says_how_it_gets_one():
    class Unknown:
        pass

    with pytest.raises(TypeError, match=r"register_text_form\(Unknown, …\) teaches it"):
        print_value(Unknown())
    with pytest.raises(ValueError, match=r"register_text_form\(Unknown, …\) teaches it"):
        parse_value("{}", Unknown)


@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        ("call driver drive()", []),
        (" call  driver\tdrive ( ) ", []),  # blanks anywhere
        ("call driver drive(1.0, 2)", ["1.0", "2"]),
        ('call driver drive(distance_m=1.0, "a b")', ["distance_m=1.0", '"a b"']),
        ('call driver drive("a, b)", \'c, "d\')', ['"a, b)"', "'c, \"d'"]),  # commas and brackets within quotes
        (r'call driver drive("a\", b")', [r'"a\", b"']),  # a quote within quotes
        ("call driver drive((1, 2), [3, {4: 5}])", ["(1, 2)", "[3, {4: 5}]"]),  # within brackets
        ("call driver drive(two words, o'clock)", ["two words", "o'clock"]),  # bare words
    ],
)
def test_a_call_is_taken_apart(text, arguments):
    assert parse_call(text) == TextCall("driver", "drive", arguments)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "expected `call PLUGIN FUNCTION(ARGUMENTS)`"),
        ("call driver", "expected `call PLUGIN FUNCTION(ARGUMENTS)`"),
        ("callx driver drive", "expected `call PLUGIN FUNCTION(ARGUMENTS)`"),
        ("call driver drive 1", "expected ( after drive, got '1'"),
        ("call driver drive(1", "expected ) before the end of '(1'"),
        ('call driver drive("1)', 'expected " before the end'),
        ("call driver drive([1)", ") without its opening bracket"),
        ("call driver drive(1))", "expected nothing after the closing ), got ')'"),
        ("call driver drive(1,,2)", "argument 2 is empty"),
    ],
)
def test_what_is_no_command_is_refused_in_words(text, complaint):
    error = refused(parse_command, text)
    assert error.code is ErrorCode.BAD_ARGUMENTS
    assert complaint in str(error)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.text() | st.text("call ()[]{}\"'\\,= a1").map(lambda text: f"call a b{text}"))
def test_any_text_is_a_command_or_bad_arguments(text):
    def outcome():
        try:
            return parse_command(text)
        except CallError as error:
            return error.code

    assert outcome() is ErrorCode.BAD_ARGUMENTS or isinstance(outcome(), (TextCall, Question))


@pytest.mark.slow
@settings(max_examples=30)
@given(st.lists(st.text(max_size=20), min_size=1, max_size=5))
def test_quoted_arguments_arrive_as_they_were_meant(texts):
    call = parse_call(f"call a b({', '.join(map(json.dumps, texts))})")
    assert [parse_value(word, str) for word in call.arguments] == texts
