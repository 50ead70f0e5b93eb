"""docs/how-to/plugins.md: its plugins run as they stand there."""

import re
from pathlib import Path

from robrain.agent.authoring.plugin_check import check_plugins
from robrain.agent.authoring.testing import PluginBench

PAGE = (Path(__file__).parent.parent / "docs" / "how-to" / "plugins.md").read_text(encoding="utf-8")


def write_files(folder):
    for language, name, text in re.findall(r"```(python|toml)\n# (\S+)\n(.*?)```", PAGE, re.DOTALL):
        assert name.endswith({"python": ".py", "toml": ".toml"}[language])
        (folder / name).write_text(text, encoding="utf-8")


def test_the_plugins_of_the_page_run(tmp_path):
    write_files(tmp_path)
    assert check_plugins(tmp_path) == []
    with PluginBench(tmp_path) as bench:
        bench.run(3.0)
        assert bench.host.manager.get("thermostat").plugin.is_on
        assert bench.call("thermostat", "want", 5) == "5 °C"
        bench.run(2.0)
        assert not bench.host.manager.get("thermostat").plugin.is_on
