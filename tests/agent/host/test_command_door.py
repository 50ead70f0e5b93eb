from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.errors import PluginInactive, PluginMissing
from robrain.agent.host.command_door import TextCommandDoor
from robrain.agent.lifecycle.external_function import external_functions, find_function
from robrain.agent.plugin import Unit, external
from robrain.agent.transform import TransformTable
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import PluginInfo


@pytest.fixture(autouse=True)
def infos_of_tags(monkeypatch):
    """The door lists plugins as the host does; a tag here says itself how it is listed."""
    monkeypatch.setattr("robrain.agent.host.command_door.plugin_info", lambda tag, _registry: tag.info())


class Garden(Unit):
    """Grows flowers."""

    @external
    def plant(self, count: int, what: str = "roses") -> int:
        """Plant some.

        They grow by themselves.
        """
        return count

    @external
    def water(self) -> None:
        """Water them."""


class Tag:
    """As much of a ManagedPlugin as the door needs."""

    def __init__(self, name, *, visible=True, active=True, transform=None):
        self.name = name
        self.active = active
        self.visible = visible
        self.manifest = SimpleNamespace(transform=transform or TransformTable())
        self.functions = external_functions(Garden)

    def call_external_text(self, function, words, *, by=""):
        self.by = by
        if not self.visible:
            raise CallError(ErrorCode.FORBIDDEN, f"{self.name} is not open to the outside")
        if not self.active:
            raise PluginInactive(self.name, f"{self.name} is inactive")
        found = find_function(self.functions, function)
        if found is None:
            raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{self.name} has no function {function}")
        return found.call_text(Garden(None, None), words)

    def info(self):
        infos = [info for function in self.functions.values() for info in function.infos]
        visibility = ["command"] if self.visible else ["behavior"]
        return PluginInfo(
            name=self.name, level="unit", state="active", visibility=visibility, doc="Grows flowers.", functions=infos
        )


class Registry:
    foreign = None

    def foreign_infos(self):
        return []

    def __init__(self, *tags):
        self.plugins = {tag.name: tag for tag in tags}

    def get(self, name):
        try:
            return self.plugins[name]
        except KeyError:
            raise PluginMissing(name, f"no plugin {name}") from None


FLOWERS = TransformTable(incoming={"BEGIN": "1"}, outgoing={"0": "END"}, both={"ROSES": "2"})
DOOR = TextCommandDoor(
    Registry(Tag("garden", transform=FLOWERS), Tag("meadow"), Tag("cellar", visible=False), Tag("asleep", active=False))
)


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("call garden plant(3)", "3"),
        ("call garden plant(BEGIN)", "1"),  # incoming
        ("call garden plant(0)", "END"),  # outgoing
        ("call garden plant(ROSES)", "ROSES"),  # there and back
        ("call garden plant(count=ROSES)", "ROSES"),
        ("call garden int.plant-int-string(2, tulips)", "ROSES"),
        ("call meadow plant(2)", "2"),  # the words are the garden's alone
        ("call garden water()", ""),
        ("list", "garden meadow asleep"),
    ],
)
def test_commands_are_executed_in_the_plugins_own_words(text, result):
    assert DOOR.call_text(text) == result


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("call nobody plant(1)", ErrorCode.UNKNOWN_PLUGIN),
        ("call garden dig()", ErrorCode.UNKNOWN_FUNCTION),
        ("call garden plant(x)", ErrorCode.BAD_ARGUMENTS),
        ("call meadow plant(ROSES)", ErrorCode.BAD_ARGUMENTS),
        ("call cellar plant(1)", ErrorCode.FORBIDDEN),
        ("call asleep plant(1)", ErrorCode.INACTIVE),
        ("help cellar", ErrorCode.UNKNOWN_PLUGIN),  # what is not open is not told of
        ("help nobody", ErrorCode.UNKNOWN_PLUGIN),
        ("dig", ErrorCode.BAD_ARGUMENTS),
    ],
)
def test_what_cannot_be_executed_is_refused_with_its_code(text, code):
    with pytest.raises(CallError) as refusal:
        DOOR.call_text(text)
    assert refusal.value.code is code


def test_the_plugin_hears_who_asks():
    tag = Tag("garden")
    TextCommandDoor(Registry(tag)).call_text("call garden plant(1)", by="ada")
    assert tag.by == "ada"


def test_help_tells_the_plugins_and_their_functions():
    assert DOOR.call_text("help").splitlines()[1:] == [
        "garden  Grows flowers.",
        "meadow  Grows flowers.",
        "asleep  Grows flowers.",
    ]
    assert DOOR.call_text("help garden").splitlines() == [
        "garden (unit, active)  Grows flowers.",
        "  plant(count: int, what: str = 'roses') -> int  Plant some.",
        "  water() -> None  Water them.",
    ]


commands = st.text(max_size=60) | st.text("garden plnt()[]{}\"'\\,=0123ROSES ", max_size=30).map(
    lambda text: f"call garden plant({text}"
)


@given(commands)
def test_any_text_is_a_result_or_an_error_of_the_enum(text):
    def outcome():
        try:
            return DOOR.call_text(text)
        except CallError as error:
            return error.code

    found = outcome()
    assert isinstance(found, ErrorCode) or type(found) is str
