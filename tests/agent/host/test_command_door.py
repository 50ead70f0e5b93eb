"""Text commands on a robot's plugins, in the plugins' own words."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.agent.lifecycle.transitions import Trigger
from robrain.protocol.errors import CallError, ErrorCode
from tests.agent.conftest import refused

GARDEN = """
    class Garden(Unit):
        'Grows flowers.'

        @external
        def plant(self, count: int, what: str = "roses") -> int:
            '''Plant some.

            They grow by themselves.
            '''
            return count

        @external
        def water(self) -> None:
            'Water them.'
"""
FLOWERS = """
[transform]
incoming = { BEGIN = "1" }
outgoing = { 0 = "END" }
both = { ROSES = "2" }
"""


@pytest.fixture
def door(bench):
    """Of a robot with a garden that has words of its own, one that is hidden and one that is not active."""
    bench.code("garden", GARDEN)
    for name in ("garden", "meadow", "asleep"):
        bench.manifest(name, "garden:Garden")
    bench.manifest("cellar", "garden:Garden", visibility=["behavior"])
    path = bench.place / "garden.toml"
    path.write_text(path.read_text() + FLOWERS)
    host = bench.start("garden", "meadow", "cellar", "asleep")
    host.manager.get("asleep").apply(Trigger.DEACTIVATE)
    return host.door


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("call garden plant(3)", "3"),
        ("call garden plant(BEGIN)", "1"),  # incoming
        ("call garden plant(0)", "END"),  # outgoing
        ("call garden plant(ROSES)", "ROSES"),  # there and back
        ("call garden int.plant-int-string(2, tulips)", "ROSES"),
        ("call meadow plant(2)", "2"),  # the words are the garden's alone
        ("call garden water()", ""),
        ("list", "asleep garden meadow"),
    ],
)
def test_commands_are_executed_in_the_plugins_own_words(door, text, result):
    assert door.call_text(text) == result


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("call nobody plant(1)", ErrorCode.UNKNOWN_PLUGIN),
        ("call garden dig()", ErrorCode.UNKNOWN_FUNCTION),
        ("call garden plant(x)", ErrorCode.BAD_ARGUMENTS),
        ("call meadow plant(ROSES)", ErrorCode.BAD_ARGUMENTS),
        ("call cellar plant(1)", ErrorCode.FORBIDDEN),
        ("call asleep plant(1)", ErrorCode.INACTIVE),
        ("help cellar", ErrorCode.UNKNOWN_PLUGIN),  # hidden plugins are not named
        ("dig", ErrorCode.BAD_ARGUMENTS),
    ],
)
def test_what_cannot_be_executed_is_refused_with_its_code(door, text, code):
    assert refused(door.call_text, text).code is code


def test_help_tells_the_plugins_and_their_functions(door):
    assert door.call_text("help").splitlines()[1:] == [
        "asleep  Grows flowers.",
        "garden  Grows flowers.",
        "meadow  Grows flowers.",
    ]
    assert door.call_text("help garden").splitlines() == [
        "garden (unit, active)  Grows flowers.",
        "  plant(count: int, what: str = 'roses') -> int  Plant some.",
        "  water() -> None  Water them.",
    ]


commands = st.text(max_size=60) | st.text("garden plnt()[]{}\"'\\,=0123ROSES ", max_size=30).map(
    lambda text: f"call garden plant({text}"
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=commands)
def test_any_text_is_a_result_or_an_error_of_the_enum(door, text):
    def outcome():
        try:
            return door.call_text(text)
        except CallError as error:
            return error.code

    found = outcome()
    assert isinstance(found, ErrorCode) or type(found) is str
