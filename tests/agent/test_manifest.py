from pathlib import Path

import pytest

from robrain.agent.errors import ManifestError, PluginMissing, short_path
from robrain.agent.manifest import find_manifests, read_manifest

GOOD = """
[plugin]
class = "lamp:Lamp"

[parameters]
brightness = 3

[tag]
visibility = ["driver", "command"]
requires = ["socket"]
shared = false
"""
LAMP = """
    class Lamp(Device):
        class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
            brightness: int = 1
"""


def write(folder: Path, text: str, name: str = "lamp") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_manifest_says_who_a_plugin_is_and_who_may_use_it(tmp_path):
    manifest = read_manifest(write(tmp_path, GOOD))
    assert (manifest.name, manifest.class_path) == ("lamp", "lamp:Lamp")
    assert manifest.parameters == {"brightness": 3}
    assert manifest.tag.visibility == ["driver", "command"]
    assert manifest.tag.requires == ["socket"]
    assert not manifest.tag.shared


@pytest.mark.parametrize(
    ("old", "new", "key", "expected"),
    [
        ("shared", "shraed", "tag", "unknown key `shraed` (did you mean `shared`?)"),  # a slip of the pen in a key
        ('class = "lamp:Lamp"', 'class = "lamp:Lamp"\nrequires = ["x"]', "plugin", "it belongs into [tag]"),
        ('class = "lamp:Lamp"', "", "plugin", "missing required field `class`"),  # no class
        ("lamp:Lamp", "lamp.Lamp", "[plugin] class", "expected module:Class, got 'lamp.Lamp'"),  # a dot for the colon
        ('class = "lamp:Lamp"', "class = 3", "plugin.class", "Expected `str`, got `int`"),  # a number for a class
        ('requires = ["socket"]', 'requires = "socket"', "tag.requires", "Expected `array`, got `str`"),  # no list
        ("brightness = 3", "brightness = = 3", "file", "is not TOML"),  # no TOML
    ],
)
def test_a_wrong_manifest_is_refused_naming_file_and_key(tmp_path, old, new, key, expected):
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new))
    with pytest.raises(ManifestError) as wrong:
        read_manifest(path)
    assert str(wrong.value).startswith(f"{path}: {key}: ")
    assert expected in str(wrong.value)
    assert (wrong.value.plugin, wrong.value.path, wrong.value.key) == ("lamp", path, key)


def test_a_file_whose_name_no_key_can_hold_is_refused(tmp_path):
    with pytest.raises(ManifestError, match=r"file name: bad plugin name 'my lamp'"):
        read_manifest(write(tmp_path, GOOD, "my lamp"))


def test_other_toml_files_beside_plugins_are_passed_over(tmp_path):
    (tmp_path / "deep").mkdir()
    write(tmp_path, '[tool]\nname = "x"', "pyproject")
    here, broken = write(tmp_path, GOOD), write(tmp_path, "= broken", "broken")
    deep = write(tmp_path / "deep", GOOD, "other")
    assert find_manifests(tmp_path) == sorted([here, deep, broken])


# -- what only shows when the plugin is loaded ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "class_path", "expected"),
    [
        (LAMP, "lump:Lamp", "cannot import lump: No module named 'lump'"),  # no such module
        (LAMP, "lamp:Light", "expected a Device, Unit, Skill or Behavior named Light in lamp"),  # no such class
        ("from robrain.agent.plugin import Plugin as Lamp", "lamp:Lamp", "expected a Device, Unit"),  # without a level
        ("import no_such_module", "lamp:Lamp", "cannot import lamp: No module named 'no_such_module'"),  # its import
        ("def Lamp(:", "lamp:Lamp", "cannot import lamp: invalid syntax"),  # no Python
    ],
)
def test_a_class_that_is_no_plugin_is_left_out_naming_file_and_key(bench, source, class_path, expected):
    bench.code("lamp", source)
    path = bench.manifest("lamp", class_path)
    bench.start("lamp")
    info = bench.infos()["lamp"]
    assert info.state == "faulted"
    assert info.why.startswith(f"{short_path(path)}: [plugin] class: ")
    assert expected in info.why


def test_wrong_parameters_leave_a_plugin_out_naming_file_and_key(bench):
    bench.code("lamp", LAMP)
    path = bench.manifest("lamp", "lamp:Lamp", {"brightnes": 3})
    bench.start("lamp")
    expected = "[parameters]: unknown key `brightnes` (did you mean `brightness`?); there is brightness"
    assert bench.infos()["lamp"].why == f"{short_path(path)}: {expected}"


def test_the_robots_file_overrides_the_manifest_and_that_the_default(bench):
    bench.code("lamp", LAMP)
    bench.manifest("one", "lamp:Lamp")
    bench.manifest("two", "lamp:Lamp", {"brightness": 2})
    bench.manifest("three", "lamp:Lamp", {"brightness": 2})
    bench.start("one", "two", "three", parameters={"three": {"brightness": 3}})
    assert [bench.plugin(name).parameters.brightness for name in ("one", "two", "three")] == [1, 2, 3]


def test_a_plugin_that_is_in_no_place_stops_the_robot_in_words(bench):
    bench.code("lamp", LAMP)
    bench.manifest("lamp", "lamp:Lamp")
    with pytest.raises(PluginMissing, match=r"no plugin lump in any place; there are: .*lamp") as missing:
        bench.start("lump")
    assert missing.value.plugin == "lump"
