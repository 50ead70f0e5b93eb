"""Devices whose packages come with the extra `hardware`, on a computer without it."""

import sys

import pytest

from robrain.agent.authoring.testing import PluginBench

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
