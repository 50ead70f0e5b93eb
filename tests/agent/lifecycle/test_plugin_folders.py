import pytest

from robrain.agent.authoring.testing import PluginBench
from robrain.agent.lifecycle.plugin_folders import entry_point_places
from robrain.agent.manifest import find_manifests
from tests.installed_distributions import install  # noqa: F401 - a fixture

LAMP = {
    "lamps/__init__.py": "",
    "lamps/lamp.toml": '[plugin]\nclass = "lamps.lamp:Lamp"\n',
    "lamps/lamp.py": "from robrain.agent.plugin import Device\n\nclass Lamp(Device):\n    'A lamp.'\n",
}


def test_a_distribution_brings_a_place_and_its_name(install):  # noqa: F811
    site = install("robrain-lamps", {"lamps": "lamps"}, LAMP)
    assert entry_point_places() == [((site / "lamps").resolve(), "robrain-lamps")]
    assert [path.name for path in find_manifests(entry_point_places()[0][0])] == ["lamp.toml"]


def test_a_place_may_lie_deeper_in_a_package_without_its_plugins_being_imported(install):  # noqa: F811
    files = {"lamps/__init__.py": "", "lamps/plugins/__init__.py": "raise RuntimeError('imported')"}
    site = install("robrain-lamps", {"lamps": "lamps.plugins"}, files)
    assert entry_point_places() == [((site / "lamps" / "plugins").resolve(), "robrain-lamps")]


@pytest.mark.parametrize(
    ("value", "files", "why"),
    [
        ("ghost", {}, "expected the name of a package"),  # no such package
        ("lamps:Lamp", LAMP, "expected the name of a package"),  # a class, as other tools have it
        ("lamp", {"lamp.py": ""}, "expected the name of a package"),  # a module: its folder is everybody's
        ("ghosts.plugins", {"ghosts/__init__.py": "1 / 0"}, "division by zero"),  # the package around it is broken
    ],
)
def test_a_broken_entry_point_is_logged_and_left_out(install, caplog, value, files, why):  # noqa: F811
    site = install("good-lamps", {"good": "good_lamps"}, {"good_lamps/__init__.py": ""})
    install("bad-lamps", {"bad": value}, files)
    assert entry_point_places() == [((site / "good_lamps").resolve(), "good-lamps")]
    (record,) = caplog.records
    assert "bad-lamps" in record.getMessage()
    assert why in record.getMessage()


def test_a_robot_loads_plugins_of_a_distribution_and_tells_where_they_come_from(install):  # noqa: F811
    install("robrain-lamps", {"lamps": "lamps"}, LAMP)
    with PluginBench(load=["lamp", "scan"]) as bench:
        assert (bench.info("lamp").state, bench.info("lamp").distribution) == ("active", "robrain-lamps")
        assert bench.info("scan").distribution == ""  # robrain's own


def test_a_place_of_the_robots_own_comes_before_that_of_a_distribution(install, tmp_path):  # noqa: F811
    install("robrain-lamps", {"lamps": "lamps"}, LAMP)
    own = tmp_path / "own"
    own.mkdir()
    (own / "lamp.toml").write_text('[plugin]\nclass = "lamps.lamp:Lamp"\n')
    with PluginBench(own) as bench:
        assert (bench.info("lamp").state, bench.info("lamp").distribution) == ("active", "")
