import pytest

from robrain.protocol.errors import ErrorCode
from tests.agent.conftest import refused

# As a student writes it: ten lines and a manifest.
GREETER = """
    class Greeter(Unit):
        \"\"\"Greets whoever asks.\"\"\"

        @external
        def hello(self, name: str = "world", times: int = 1) -> str:
            \"\"\"A greeting.\"\"\"
            return " ".join([f"hello {name}"] * times)
"""
MORE = """
    class Place(msgspec.Struct):
        x_m: float
        y_m: float = 0.0

    class LowInterface(Protocol):
        def poke(self) -> None: ...

    class Low(Device):
        interface = LowInterface
        def poke(self) -> None: pass

    class More(Unit):
        def activate(self): self.low = self.env.use("low", LowInterface)

        def hidden(self) -> str: return "hidden"

        @external
        def add(self, a: int, b: int = 10) -> int: return a + b

        @external
        def mirror(self, place: Place) -> Place: return Place(-place.x_m, -place.y_m)

        @external
        def choose(self, of: list[int] | None = None) -> int | None: return max(of) if of else None

        @external
        def crash(self) -> None: raise RuntimeError("it went wrong")

        @external
        def unspeakable(self): return object()

        @external
        def poke(self) -> str:
            self.low.poke()
            return "poked"
"""


@pytest.fixture
def greeter(bench):
    bench.code("greeter", GREETER)
    bench.manifest("greeter", "greeter:Greeter")
    bench.start("greeter")
    return bench


@pytest.fixture
def more(bench):
    bench.code("more", MORE)
    bench.manifest("low", "more:Low", visibility=["more"])
    bench.manifest("more", "more:More", requires=["low"])
    bench.start("more")
    return bench


def test_a_students_plugin_is_called_by_position_by_name_and_by_default(greeter):
    assert greeter.call("greeter", "hello") == greeter.call("greeter", "hello", b"  ") == "hello world"
    assert greeter.call("greeter", "hello", ["you", 2]) == "hello you hello you"
    assert greeter.call("greeter", "hello", {"times": 2}) == "hello world hello world"
    assert greeter.call("greeter", "hello", {"times": 2, "name": "you"}) == "hello you hello you"


def test_the_robot_tells_what_can_be_called_and_how(greeter):
    info = greeter.infos()["greeter"]
    assert (info.level, info.state, info.doc, info.period_s) == ("unit", "active", "Greets whoever asks.", None)
    (function,) = info.functions
    assert (function.name, function.doc) == ("hello", "A greeting.")
    assert function.signature == "(name: str = 'world', times: int = 1) -> str"
    (definition,) = function.parameters["$defs"].values()
    assert definition["properties"]["times"] == {"type": "integer", "default": 1}
    assert function.returns == {"type": "string"}


@pytest.mark.parametrize(
    ("function", "arguments", "result"),
    [
        ("add", [1], 11),
        ("mirror", [{"x_m": 1.0}], {"x_m": -1.0, "y_m": -0.0}),
        ("choose", [[3, 1, 2]], 3),
        ("choose", [None], None),
        ("poke", None, "poked"),
    ],
)
def test_arguments_and_results_are_typed(more, function, arguments, result):
    assert more.call("more", function, arguments) == result


@pytest.mark.parametrize(
    ("function", "arguments", "named"),
    [
        ("add", ["one"], "Expected `int`, got `str` for argument `a`"),  # a wrong type
        ("add", None, "missing required field `a`"),  # nothing given
        ("add", [1, 2, 3], "add takes at most 2 arguments, got 3"),  # one too many
        ("add", {"a": 1, "c": 2}, "unknown field `c`"),  # a name that is none
        ("add", b"[1", "arguments are not JSON"),  # cut
        ("add", b"[" * 100_000, "arguments are not JSON"),  # nested too deep
        ("add", 3, "expected a JSON array or object of arguments"),  # neither
        ("mirror", [{"y_m": 1.0}], "missing required field `x_m` for argument `place`"),  # within an argument
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) < 20 else "",
)
def test_bad_arguments_are_refused_naming_the_argument(more, function, arguments, named):
    error = refused(more.call, "more", function, arguments)
    assert error.code is ErrorCode.BAD_ARGUMENTS
    assert named in str(error)
    assert function in str(error)


def test_an_unknown_function_is_refused_with_the_names_of_those_there_are(more):
    error = refused(more.call, "more", "subtract")
    assert error.code is ErrorCode.UNKNOWN_FUNCTION
    assert str(error) == "more has no function subtract; it has: add, choose, crash, mirror, poke, unspeakable"


@pytest.mark.parametrize("function", ["hidden", "activate", "deactivate", "env", "__init__"])
def test_what_is_not_marked_external_does_not_exist_outside(more, function):
    assert refused(more.call, "more", function).code is ErrorCode.UNKNOWN_FUNCTION


def test_a_plugin_that_is_not_open_to_the_outside_is_forbidden(more):
    error = refused(more.call, "low", "poke")
    assert (error.code, str(error)) == (ErrorCode.FORBIDDEN, "low is not open to the outside")


def test_a_function_that_raises_is_answered_failed_and_the_plugin_goes_on(more):
    error = refused(more.call, "more", "crash")
    assert (error.code, str(error)) == (ErrorCode.FAILED, "RuntimeError: it went wrong")
    assert more.call("more", "add", [1, 1]) == 2


def test_a_result_that_json_has_no_word_for_is_answered_failed(more):
    error = refused(more.call, "more", "unspeakable")
    assert error.code is ErrorCode.FAILED
    assert "unsupported" in str(error)
