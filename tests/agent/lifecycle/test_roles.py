"""A plugin that takes the place of another: same name, same callers, chosen in the robot's file."""

from pathlib import Path

import pytest

from robrain.agent.authoring.plugin_check import check_plugins
from robrain.agent.authoring.testing import PluginBench
from robrain.agent.errors import ManifestError, PluginMissing
from robrain.agent.manifest import read_manifest

CODE = """
    class Lamp(Protocol):
        def light(self) -> str: ...

    class Plain(Device):
        "A lamp."
        interface = Lamp
        @external
        def light(self) -> str:
            "What it is."
            return "plain"

    class Bright(Device):
        "Another lamp."
        interface = Lamp
        class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
            watts: int = 40
        @external
        def light(self) -> str:
            "What it is."
            return f"bright, {self.parameters.watts} W"

    class Desk(Unit):
        "Has a lamp."
        def activate(self) -> None: self._lamp = self.env.use("lamp", Lamp)
        @external
        def light(self) -> str:
            "Of its lamp."
            return self._lamp.light()
"""


@pytest.fixture
def place(bench) -> Path:
    bench.code("lamps", CODE)
    bench.manifest("lamp", "lamps:Plain", visibility=["*", "command"])
    bench.manifest("desk", "lamps:Desk", requires=["lamp"])
    path = bench.manifest("bright_lamp", "lamps:Bright", visibility=["*", "command"])
    path.write_text('plugin.role = "lamp"\n' + path.read_text().replace("[plugin]\nclass", "plugin.class"))
    return bench.place


def test_it_takes_the_place_under_the_name_of_the_other_with_its_parameters_and_callers(place: Path) -> None:
    with PluginBench(place, roles={"lamp": "bright_lamp"}, parameters={"lamp": {"watts": 60}}) as bench:
        assert bench.call("desk", "light") == "bright, 60 W"
        assert "bright_lamp" not in bench.host.manager.plugins
        assert bench.host.manager.reload("lamp").name == "lamp"
        assert bench.call("desk", "light") == "bright, 60 W"


@pytest.mark.parametrize("chosen", ["desk", "no_lamp"])
def test_what_is_not_for_the_role_is_refused_with_those_that_are(place: Path, chosen: str) -> None:
    bench = PluginBench(place, roles={"lamp": chosen})
    with pytest.raises(PluginMissing, match=rf"\[robot.roles\] lamp: no plugin {chosen} .*: bright_lamp, lamp$"), bench:
        pass


def test_a_role_must_be_a_name(place: Path) -> None:
    (place / "bright_lamp.toml").write_text('[plugin]\nclass = "lamps:Bright"\nrole = "a/b"\n')
    with pytest.raises(ManifestError, match=r"\[plugin\] role"):
        read_manifest(place / "bright_lamp.toml")


def test_the_check_finds_nothing_wrong_but_a_role_that_there_is_not(place: Path) -> None:
    assert check_plugins(place) == []
    (place / "bright_lamp.toml").write_text('[plugin]\nclass = "lamps:Bright"\nrole = "lampe"\n')
    (found,) = check_plugins(place)
    assert (found.key, found.message) == (
        "[plugin] role",
        "there is no plugin lampe whose place it could take; is lamp meant?",
    )
