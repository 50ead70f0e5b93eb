from pathlib import Path

import pytest

from robrain.agent.authoring.plugin_check import check_plugins
from robrain.agent.host.agent_host import stock_place

LAMPS = """
    class LampInterface(Protocol):
        dimmed: Event[int]
        brightness: int

        def dim(self, to: int, *, slowly: bool = False) -> int: ...

    class Lamp(Device):
        'A lamp.'

        class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
            watts: int = 1

            def __post_init__(self):
                if self.watts < 1:
                    raise ValueError("expected watts >= 1")

        interface = LampInterface
        dimmed = Event[int]()

        def init(self):
            self.brightness = 0

        def dim(self, to: int, *, slowly: bool = False) -> int:
            return to

        @external
        def shine(self, times: int = 1) -> None:
            'Shine.'

    class Chandelier(Unit):
        'Several lamps.'
        interface = LampInterface
        dimmed = Event[int]()
        brightness = 0

        def dim(self, to: int, *, slowly: bool = False) -> int:
            return to

    class Evening(Skill):
        'Dims them.'
"""
LAMP_FILE = "lamps.py"


@pytest.fixture
def lamps(bench):
    """A folder with three sound plugins."""
    bench.code("lamps", LAMPS)
    bench.manifest("lamp", "lamps:Lamp", visibility=["chandelier", "command"])
    bench.manifest("chandelier", "lamps:Chandelier", visibility=["evening"], requires=["lamp"])
    bench.manifest("evening", "lamps:Evening", visibility=[], requires=["chandelier"])
    return bench


def found(bench):
    """Each finding as its file, its key and its text."""
    return [
        (finding.path.name, finding.key, ("warning: " if finding.is_warning else "") + finding.message)
        for finding in check_plugins(bench.place)
    ]


def edit(bench, old: str, new: str) -> None:
    path = bench.place / LAMP_FILE
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_there_is_nothing_to_say_of_sound_plugins(lamps):
    assert found(lamps) == []


def test_there_is_nothing_to_say_of_the_stock_plugins_and_the_examples():
    examples = Path(__file__).parents[3] / "examples" / "03_your_own_plugin"
    assert check_plugins(stock_place()) == []
    assert check_plugins(examples) == []


# -- manifests --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "key", "message"),
    [
        ('[plugin]\nclass = "lamps:Lamp"\n[tag]\nshraed = true', "tag", "unknown key `shraed` (did you mean"),
        ('[plugn]\nclass = "lamps:Lamp"\n[tag]\nshared = true', "file", "expected a table [plugin]"),  # passed over
    ],
)
def test_a_wrong_manifest_is_found(lamps, text, key, message):
    (lamps.place / "other.toml").write_text(text)
    ((path, found_key, found_message),) = found(lamps)
    assert (path, found_key) == ("other.toml", key)
    assert message in found_message


def test_a_name_that_is_there_twice_is_found(lamps):
    (lamps.place / "z").mkdir()
    (lamps.place / "z" / "lamp.toml").write_bytes((lamps.place / "lamp.toml").read_bytes())
    findings = check_plugins(lamps.place)
    assert str(lamps.place / "lamp.toml") in findings[0].message
    assert findings[0].path == lamps.place / "z" / "lamp.toml"
    assert not findings[0].is_warning


def test_taking_the_place_of_a_stock_plugin_is_worth_a_warning(lamps):
    lamps.manifest("battery", "lamps:Lamp")
    ((path, _, message),) = found(lamps)
    assert path == "battery.toml"
    assert message.startswith("warning: takes the place of battery in ")


# -- classes and parameters -------------------------------------------------------------------------------------


KIND = """
import msgspec

class Wanted(msgspec.Struct):
    FIELD: float

class Other(Behavior):
    kind = "a kind"
    task_parameters = Wanted
"""
UNTOLD = """
class Other(Unit):
    'Cannot tell its function to anybody.'
    @external
    def f(self, x: HINT) -> None:
        'F.'
"""


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import no_such_module", "cannot import other: No module named 'no_such_module' (other.py, line "),
        ("def Other(:", "cannot import other: invalid syntax (other.py, line "),
        ("raise SystemExit(3)", "cannot import other: it calls exit() (other.py, line "),
        ("class Other: pass", "expected a Device, Unit, Skill or Behavior named Other"),
        (UNTOLD.replace("HINT", "'Nothing'"), "the external functions of Other: name 'Nothing' is not defined"),
        (UNTOLD.replace("HINT", "type(lambda: 0)"), "the external functions of Other: "),
        (
            KIND.replace("a kind", "watch").replace("FIELD", "priority"),
            "the task kind of Other: task_parameters: priority is a field of every task",
        ),
        (KIND.replace("a kind", "a/kind"), "the task kind of Other: bad kind of task name 'a/kind'"),
    ],
)
def test_a_class_that_cannot_be_loaded_is_found(lamps, source, message):
    lamps.code("other", source)
    lamps.manifest("other", "other:Other")
    ((path, key, found_message),) = found(lamps)
    assert (path, key) == ("other.toml", "[plugin] class")
    assert message in found_message


@pytest.mark.parametrize(
    ("parameters", "key", "message"),
    [
        ({"watts": "many"}, "[parameters] watts", "Expected `int`, got `str`"),
        ({"wats": 3}, "[parameters]", "unknown key `wats` (did you mean `watts`?)"),
        ({"watts": 0}, "[parameters]", "expected watts >= 1"),
    ],
)
def test_parameters_that_do_not_convert_are_found(lamps, parameters, key, message):
    lamps.manifest("lamp", "lamps:Lamp", parameters, visibility=["chandelier"])
    ((path, found_key, found_message),) = found(lamps)
    assert (path, found_key) == ("lamp.toml", key)
    assert message in found_message


def test_a_parameter_that_only_a_robots_file_can_set_is_worth_a_warning(lamps):
    edit(lamps, "watts: int = 1", "watts: int")
    assert found(lamps) == [
        ("lamp.toml", "[parameters] watts", "warning: no value and no default: each robot's file must set it")
    ]


PERIOD = "expected a number of seconds above 0, or None, got"


@pytest.mark.parametrize(
    ("lines", "key", "message"),
    [
        (["Parameters = dict"], "Evening.Parameters", "expected a struct"),
        (["period_s = 0", "def step(self): pass"], "Evening.period_s", f"{PERIOD} 0"),
        (["period_s = float('nan')", "def step(self): pass"], "Evening.period_s", f"{PERIOD} nan"),
        (["def step(self): return self.period_s"], "Evening.step", "warning: is never called"),
        (["period_s = 1.0"], "Evening.period_s", "warning: there is no step"),
        (["@external", "def f(self) -> int: return 1"], "Evening.f", "warning: no docstring"),
        (["@external", "def f(self, x, y: int) -> int:", "    'F.'"], "Evening.f", "warning: no type hint for x:"),
        (["def activate(self): self.env.use('driver', object)"], "Evening.activate", "uses driver: name it in [tag]"),
        (["def init(self): self.period_s = 0.5", "def step(self): pass"], "", ""),
    ],
)
def test_a_class_is_checked(lamps, lines, key, message):
    edit(lamps, "'Dims them.'", "\n    ".join(["'Dims them.'", *lines]))
    findings = found(lamps)
    assert [(path, found_key) for path, found_key, _ in findings] == ([(LAMP_FILE, key)] if key else [])
    assert all(text.startswith(message) for _, _, text in findings)


def test_a_visibility_that_no_plugin_has_is_found(lamps):
    lamps.manifest("evening", "lamps:Evening", visibility=["exploer", "command", "*", "lamp"])
    assert found(lamps) == [("evening.toml", "[tag] visibility", "there is no plugin exploer; is explore meant?")]


# -- interfaces -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "key", "message"),
    [
        ("def dim(self", "def dimm(self", "dim", "LampInterface has the function dim, Lamp has not"),
        ("dim(self, to: int, *,", "dim(self, to: int, hard: int, *,", "dim", "cannot be called as"),  # one too many
        ("slowly: bool = False) -> int:\n", "slowly: bool) -> int:\n", "dim", "cannot be called as"),  # no default
        ("dim(self, to: int, *,", "dim(self, to: str, *,", "dim", "takes str for to, LampInterface promises to take"),
        ("= False) -> int:\n", "= False) -> str:\n", "dim", "returns str, LampInterface promises int"),
        ("dimmed = Event[int]()", "", "dimmed", "LampInterface has the event dimmed, Lamp has not"),
        ("self.brightness = 0", "pass", "brightness", "LampInterface has brightness, Lamp has not"),
        ("interface = LampInterface", "interface = 3", "interface", "expected a Protocol, got 3"),
    ],
)
def test_an_interface_that_the_class_does_not_keep_is_found(lamps, old, new, key, message):
    path = lamps.place / LAMP_FILE
    protocol, lamp, rest = path.read_text().partition("class Lamp(Device):")
    assert old in rest
    path.write_text(protocol + lamp + rest.replace(old, new, 1))
    ((name, found_key, found_message),) = found(lamps)
    assert (name, found_key) == (LAMP_FILE, f"Lamp.{key}")
    assert message in found_message


@pytest.mark.parametrize(
    "signature",
    [
        "(self, to, *, slowly=False)",  # no hints: nothing to compare
        "(self, to: float, *, slowly: bool = True) -> bool",  # takes more, promises more
        "(self, to: int | str, slowly: bool = False, hard: bool = False) -> int",  # more than is promised
        "(self, *arguments, **options)",
        "(self, to: 'Nowhere', *, slowly: bool = False) -> int",  # a hint for the type checker only
    ],
)
def test_a_function_may_do_more_than_its_interface_promises(lamps, signature):
    path = lamps.place / LAMP_FILE
    protocol, lamp, rest = path.read_text().partition("class Lamp(Device):")
    rest = rest.replace("(self, to: int, *, slowly: bool = False) -> int", signature, 1)
    path.write_text(protocol + lamp + rest)
    assert found(lamps) == []


@pytest.mark.parametrize(
    ("promised", "own", "fits"),
    [
        ("(self, x: list[int]) -> None", "(self, x: list[str]) -> None", False),
        ("(self, x: dict[str, int]) -> None", "(self, x: dict) -> None", True),
        ("(self, x: Circle) -> None", "(self, x: Shape) -> None", True),  # takes more
        ("(self, x: Shape) -> None", "(self, x: Circle) -> None", False),  # takes less
        ("(self) -> Circle | None", "(self) -> Circle", True),
        ("(self, x: int, /) -> None", "(self, other: int, /) -> None", True),  # its name is nobody's business
        ("(self, x: int, y: int) -> None", "(self, y: int, x: int) -> None", False),  # the other way round
    ],
)
def test_types_and_places_of_parameters_are_compared(bench, promised, own, fits):
    bench.code(
        "shapes",
        f"""
        class Shape: ...
        class Circle(Shape): ...
        class DrawInterface(Protocol):
            def draw{promised}: ...
        class Draw(Unit):
            'Draws.'
            interface = DrawInterface
            def draw{own}: ...
        """,
    )
    bench.manifest("draw", "shapes:Draw")
    assert [key for _, key, _ in found(bench)] == ([] if fits else ["Draw.draw"])


# -- who requires and sees whom ---------------------------------------------------------------------------------


def test_a_requirement_that_nobody_provides_is_found_and_the_likely_one_named(lamps):
    lamps.manifest("evening", "lamps:Evening", requires=["chandeleir", "xyzzy"])
    likely, other = found(lamps)
    assert likely == ("evening.toml", "[tag] requires", "nobody provides chandeleir; is chandelier meant?")
    assert other[2].startswith("nobody provides xyzzy; there are: ")
    assert "chandelier" in other[2]


def test_a_requirement_of_no_lower_level_names_the_level_that_it_needs(lamps):
    lamps.manifest("other", "lamps:Lamp", requires=["chandelier"])
    lamps.manifest("chandelier", "lamps:Chandelier", visibility=["evening", "other"], requires=["lamp"])
    ((path, key, message),) = found(lamps)
    assert (path, key) == ("other.toml", "[tag] requires")
    assert message.startswith("other (device) may not call chandelier (unit): ")
    assert message.endswith("calls go to lower levels only; make other a skill")


def test_a_circle_is_found_once_with_its_full_path(lamps):
    lamps.manifest("lamp", "lamps:Lamp", visibility=["chandelier"], requires=["evening"])
    lamps.manifest("evening", "lamps:Evening", visibility=["lamp"], requires=["chandelier"])
    (circle,) = [message for _, _, message in found(lamps) if "requires itself" in message]
    name, _, path = circle.partition(" requires itself: ")
    assert path.split(" → ")[0] == path.split(" → ")[-1] == name
    assert set(path.split(" → ")) == {"lamp", "evening", "chandelier"}


def test_two_that_want_an_unshared_plugin_are_worth_a_warning(lamps):
    lamps.manifest("lamp", "lamps:Lamp", visibility=["*"], shared=False)
    lamps.manifest("evening", "lamps:Evening", requires=["lamp"])
    texts = [text for _, _, text in found(lamps)]
    assert texts == [
        "warning: lamp is not shared, and evening may hold it",
        "warning: lamp is not shared, and chandelier may hold it",
    ]


def test_a_requirement_without_an_interface_is_worth_a_warning(lamps):
    edit(lamps, "interface = LampInterface", "")
    assert found(lamps) == [("chandelier.toml", "[tag] requires", "warning: lamp has no interface to call it by")]
