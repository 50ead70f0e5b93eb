import json
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.lifecycle.external_function import external_functions, find_function
from robrain.agent.plugin import Unit, external, unlocked
from robrain.agent.text_form import print_value
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.keys import check_name
from tests.agent.test_text_form import Complex


class Foo(Unit):
    """Foos in many ways."""

    @external("foo")
    def foo_text(self, a: int, b: str) -> None:
        """As the paper's foo."""

    @external("foo")
    def foo_number(self, a: int) -> str:
        return f"int {a}"

    @external("foo")
    def foo_fraction(self, a: float) -> str:
        return f"double {a}"

    @external("foo")
    def foo_word(self, a: str) -> str:
        return f"string {a}"

    @external("foo")
    def foo_named(self, who: str, loud: bool = False) -> str:
        return f"who {who} {loud}"

    @external
    def apart(self, a: int, *, b: int = 2) -> list[int]:
        """Takes `b` as a keyword only."""
        return [a, b]

    @external("twin")
    def twin_int(self, a: int) -> int:
        return a

    @external("twin")
    def twin_void(self, a: int) -> None:
        pass

    @external("near")
    def near_one(self, a: int) -> str:
        return "one"

    @external("near")
    def near_two(self, a: int, b: int = 0) -> str:
        return "two"

    @external
    def hello(self, name: str = "world") -> float:
        return float(len(name))

    @external
    def add(self, a: Complex, b: Complex) -> Complex:
        return Complex(a.re + b.re, a.im + b.im)

    @external
    def total(self, of: list[Complex]) -> dict[str, Complex]:
        return {"total": Complex(sum(one.re for one in of), sum(one.im for one in of))}

    @external
    def echo(self, value: Any) -> Any:
        return value

    @external
    def raw(self) -> bytes:
        return b"raw"

    @external
    def table(self, of: dict[int, str]) -> int:
        return sum(of)

    @external
    @unlocked
    def free(self) -> None:
        pass

    @external
    def gather(self, more: int, into: list[int] = []) -> list[int]:  # noqa: B006 - each call has its own
        into.append(more)
        return into


FUNCTIONS = external_functions(Foo)
FOO = Foo(None, None)


def call(name: str, arguments: Any = None) -> Any:
    function = find_function(FUNCTIONS, name)
    return function.call(FOO, b"" if arguments is None else json.dumps(arguments).encode())


def call_text(name: str, *words: str) -> str:
    return find_function(FUNCTIONS, name).call_text(FOO, list(words))


def refused(function, *arguments) -> str:
    with pytest.raises(CallError) as refusal:
        function(*arguments)
    assert refusal.value.code is ErrorCode.BAD_ARGUMENTS
    return str(refusal.value)


@pytest.mark.parametrize(
    ("name", "signatures"),
    [
        ("foo", "void.foo-int-string string.foo-int string.foo-double string.foo-string string.foo-string-bool"),
        ("hello", "double.hello-string"),
        ("free", "void.free"),
        ("total", "dict_string_Complex.total-list_Complex"),
        ("echo", "any.echo-any"),
    ],
)
def test_signatures_read_as_in_the_paper(name, signatures):
    found = [signature.signature_name for signature in FUNCTIONS[name].signatures]
    assert found == signatures.split()
    for signature in found:
        assert check_name("function", signature) == signature  # it can stand in a key


@pytest.mark.parametrize(("arguments", "result"), [([1], [1, 2]), ([1, 3], [1, 3]), ({"a": 1, "b": 3}, [1, 3])])
def test_a_parameter_that_python_takes_by_name_only_has_its_place_in_json(arguments, result):
    assert call("apart", arguments) == result


@pytest.mark.parametrize(
    ("arguments", "result"),
    [
        ([1, "x"], None),  # by number and types
        (["x", True], "who x True"),
        ([1], "int 1"),  # a whole number is an int,
        ([1.5], "double 1.5"),  # another a double,
        (["one"], "string one"),  # and text a string, of which none is left to its default
        ({"a": 1}, "int 1"),
        ({"who": "you"}, "who you False"),  # by name
    ],
)
def test_the_overload_that_fits_is_called(arguments, result):
    assert call("foo", arguments) == result


@pytest.mark.parametrize(
    ("words", "result"),
    [
        (["1", "x"], ""),
        (["1"], "int 1"),
        (["one"], "string one"),  # a bare word that spells nothing else
        (['"1"'], "string 1"),  # quotes say that text is meant
        (["who=1"], "who 1 False"),
        (["b=x", "1"], ""),  # the one without a name fills what is left
        (["one", "loud=true"], "who one True"),
    ],
)
def test_the_overload_that_fits_the_text_is_called(words, result):
    assert call_text("foo", *words) == result


def test_a_signature_name_selects_exactly():
    assert call("string.foo-double", [1]) == "double 1.0"
    assert call("string.foo-string-bool", ["x"]) == "who x False"
    assert call_text("void.foo-int-string", "1", "x") == ""
    assert "missing required field `a`" in refused(call, "void.foo-int-string", [])


def test_overloads_that_fit_equally_are_ambiguous_and_named():
    message = refused(call, "twin", [1])
    assert message == "twin is ambiguous with these arguments; call one of int.twin-int, void.twin-int"
    assert call("int.twin-int", [1]) == 1
    assert call_text("void.twin-int", "1") == ""


def test_fewer_defaults_decide_when_types_do_not():
    assert call("near", [1]) == "one"
    assert call("near", [1, 2]) == "two"
    assert call_text("near", "1") == "one"


def test_arguments_that_fit_no_overload_are_refused_with_each_candidate_and_why():
    for message in (refused(call, "near", ["x"]), refused(call_text, "near", "x")):
        assert message.startswith("no near takes these arguments: string.near-int (")
        assert "string.near-int-int (" in message


def test_an_own_type_is_taken_and_given_as_json():
    assert call("add", ["(1, 2)", "(3, 4)"]) == "(4, 6)"
    assert call("total", [["(1, 2)", "(3, 4)"]]) == {"total": "(4, 6)"}
    assert call("echo", [3]) == 3
    info = FUNCTIONS["add"].infos[0]
    assert info.returns == {"title": "Complex", "type": "string"}
    assert info.parameters["$defs"]["add_arguments"]["properties"]["a"] == {"title": "Complex", "type": "string"}


def test_an_own_type_that_does_not_parse_is_refused_naming_the_argument():
    assert "expected a Complex, got 'x'" in refused(call, "add", ["(1, 2)", "x"])
    assert "for argument `b`" in refused(call, "add", ["(1, 2)", "x"])
    assert "argument `b`: expected a Complex, got 'x'" in refused(call_text, "add", "(1, 2)", "x")


def test_a_result_of_bytes_is_json_as_its_schema_says():
    assert call("raw") == "cmF3"
    assert FUNCTIONS["raw"].infos[0].returns["contentEncoding"] == "base64"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["x", "y"], "hello takes at most 1 arguments, got 2"),
        (["name=x", "name=y"], "argument `name` is given twice"),
        (["nam=x"], "no parameter `nam`; put text that contains = in quotes"),
        (['"open'], "argument `name`: expected one text between double quotes"),
    ],
)
def test_text_that_does_not_fit_is_refused_naming_the_argument(words, complaint):
    assert complaint in refused(call_text, "hello", *words)


def test_text_arguments_have_their_defaults():
    assert call_text("hello") == "5.0"
    assert call_text("gather", "1") == "[1]"
    assert call_text("gather", "1") == "[1]"  # the default list is not shared between calls
    assert call("gather", [1]) == [1]
    assert "missing argument `more`" in refused(call_text, "gather")


def test_an_overridden_function_keeps_its_place_and_a_hidden_one_goes():
    class Sub(Foo):
        @external("foo")
        def foo_number(self, a: int) -> int:
            return -a

        def hello(self, name: str = "") -> float:
            return 0.0

    functions = external_functions(Sub)
    assert "hello" not in functions
    assert functions["foo"].signature_names[:3] == ["void.foo-int-string", "int.foo-int", "string.foo-double"]


def test_two_functions_of_one_signature_are_refused():
    class Same(Unit):
        @external("same")
        def one(self, a: int) -> None: ...
        @external("same")
        def two(self, b: int) -> None: ...

    with pytest.raises(TypeError, match=r"two external functions have the signature void\.same-int"):
        external_functions(Same)


def test_functions_that_nobody_can_call_are_refused():
    class Unknown:
        pass

    class Many(Unit):
        @external
        def many(self, *all_of: int) -> None: ...

    class Strange(Unit):
        @external
        def strange(self, one: Unknown) -> None: ...

    with pytest.raises(TypeError, match=r"many: external functions take named parameters, \*all_of: int is none"):
        external_functions(Many)
    with pytest.raises(TypeError, match="Unknown is not supported"):
        external_functions(Strange)


@pytest.mark.parametrize("name", ["", "a b", "a.b", "a-b", "1a", "ä", "*"])
def test_a_name_that_cannot_be_called_is_refused(name):
    with pytest.raises(ValueError, match="external name"):
        external(name)(lambda self: None)


def outcome(attempt) -> ErrorCode | None:
    """The code of the error; None for a result, which must be text."""
    try:
        assert isinstance(attempt(), str)
    except CallError as error:
        return error.code
    return None


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "b", "who"]), inner, max_size=3),
    max_leaves=5,
)


@pytest.mark.slow
@given(st.sampled_from(sorted(FUNCTIONS)), st.binary() | json_values.map(lambda value: json.dumps(value).encode()))
def test_any_payload_is_a_result_or_bad_arguments(name, payload):
    def attempt() -> str:
        return msgspec.json.encode(FUNCTIONS[name].call(FOO, payload)).decode()

    assert outcome(attempt) in (None, ErrorCode.BAD_ARGUMENTS)


@pytest.mark.slow
@given(st.sampled_from(sorted(FUNCTIONS)), st.lists(st.text(max_size=10), max_size=4))
def test_any_words_are_a_result_or_bad_arguments(name, words):
    assert outcome(lambda: FUNCTIONS[name].call_text(FOO, words)) in (None, ErrorCode.BAD_ARGUMENTS)


@pytest.mark.slow
@given(st.integers() | st.text())
def test_json_and_text_choose_the_same_overload(argument):
    assert call_text("foo", json.dumps(argument)) == print_value(call("foo", [argument]))
