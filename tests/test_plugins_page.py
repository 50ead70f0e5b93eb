"""docs/plugins.md: its plugins run as they stand there, and its table is that of the manifest."""

import re
import subprocess
import sys
from pathlib import Path

import msgspec

from robrain.agent.manifest import TagTable
from robrain.agent.plugin_check import check_plugins
from robrain.testing import PluginBench

PAGE = (Path(__file__).parent.parent / "docs" / "plugins.md").read_text(encoding="utf-8")


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


def test_the_tests_of_the_page_pass(tmp_path):
    write_files(tmp_path)
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-W",
        "error",
        str(tmp_path / "test_heat.py"),
    ]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "2 passed" in done.stdout, done.stdout


def test_the_table_of_the_bench_names_each_of_its_members():
    public = {name for name in (*vars(PluginBench), *PluginBench.__annotations__) if not name.startswith("_")}
    with PluginBench() as bench:
        public |= {name for name in vars(bench) if not name.startswith("_")}
    for name in public:
        assert re.search(rf"^\|.*`{name}\b", PAGE, re.MULTILINE), name


def test_the_table_of_the_page_names_each_key_of_the_tag_with_its_default():
    for field in msgspec.structs.fields(TagTable):
        assert f"`{field.name}`" in PAGE or f"[tag] {field.name}`" in PAGE
        if isinstance(field.default, (int, float)) and not isinstance(field.default, bool):
            assert re.search(rf"`{field.name}`.*\b{re.escape(str(field.default))}\b", PAGE), field.name
