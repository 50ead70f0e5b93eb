"""The bench of plugin authors: a plugin that does not come back ends the test with its line."""

from pathlib import Path

import pytest

from robrain.agent.authoring import testing
from robrain.agent.authoring.testing import PluginBench
from robrain.agent.errors import PluginHung

LOOPS = {"module": "while True: pass", "init": "", "activate": "", "step": "", "shine": ""}


def use_lamp(folder: Path) -> None:
    with PluginBench(folder) as bench:
        bench.run(1.0)
        bench.call("lamp", "shine")


@pytest.mark.parametrize("where", LOOPS)
def test_an_endless_loop_ends_with_an_error_that_names_file_and_line(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(testing, "HANG_CPU_S", 0.1)
    monkeypatch.setattr(testing, "WATCH_S", 0.05)
    functions = "".join(
        f"    {'@external' if name == 'shine' else ''}\n    def {name}(self) -> None:\n"
        f"        {'while True: [' + repr(name) + ']' if name == where else 'pass'}\n"
        for name in ("init", "activate", "step", "shine")
    )
    head = "from robrain import Device, external\n" + LOOPS[where] + "\nclass Lamp(Device):\n    period_s = 0.1\n"
    (tmp_path / "lamp.py").write_text(head + functions)
    (tmp_path / "lamp.toml").write_text('[plugin]\nclass = "lamp:Lamp"\n')
    line = 1 + next(number for number, line in enumerate((head + functions).splitlines()) if "while True" in line)
    with pytest.raises(PluginHung) as hung:
        use_lamp(tmp_path)
    assert f"lamp.py:{line} in {'<module>' if where == 'module' else where}" in str(hung.value)
