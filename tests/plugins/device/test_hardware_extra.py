"""Devices whose packages come with the extra `hardware`, on a computer without it."""

import sys
from pathlib import Path

import pytest

from robrain.agent.authoring.testing import PluginBench
from robrain.deploy.machine.doctor import check_extras, check_robot_file

GPIO, I2C = "robrain.plugins.device.gpio", "robrain.plugins.device.bm2"
MODULES = {
    "emergency_stop": ("gpio_emergency_stop", "gpiod", (GPIO,)),
    "range_sensors": ("gpio_bumpers", "gpiod", (GPIO,)),
    "bm2": ("smart_battery", "smbus2", (f"{I2C}.i2c_battery",)),
}


@pytest.fixture(params=MODULES)
def lacking(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """A role, and a plugin for it whose package is not installed."""
    plugin, package, modules = MODULES[request.param]
    for name in modules:
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    return request.param, plugin


def test_the_plugin_list_says_which_extra_is_missing(lacking: tuple[str, str]) -> None:
    role, plugin = lacking
    with PluginBench(load=[role], roles={role: plugin}) as bench:
        info = bench.info(role)
        assert (info.state, info.needs) == ("faulted", "robrain[hardware]")
        bench.run(0.2)
        assert bench.host.manager.halted == (role == "emergency_stop")


def test_the_doctor_says_what_to_install(lacking: tuple[str, str], tmp_path: Path) -> None:
    role, plugin = lacking
    path = tmp_path / "r1.toml"
    path.write_text(f'[robot]\nname = "r1"\nload = ["{role}"]\n[robot.roles]\n{role} = "{plugin}"\n')
    found, _ = check_robot_file(path)
    assert found is not None
    check = check_extras(found)
    assert not check.ok
    assert check.sentence == f"packages are missing: {role} need robrain[hardware]"
    assert check.remedy == "pip install 'robrain[hardware]'"


def test_a_robot_without_these_roles_imports_none_of_them() -> None:
    with PluginBench(load=["bm2", "range_sensors"]) as bench:
        assert {bench.info(name).state for name in ("bm2", "range_sensors")} == {"active"}
        assert bench.info("bm2").needs == ""
