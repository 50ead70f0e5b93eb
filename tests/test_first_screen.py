"""The commands on the README's first screen work as printed."""

import re

from tests.system.conftest import ROOT

README = (ROOT / "README.md").read_text()


def test_the_shell_is_told_of_the_virtual_environment_before_robrain_is_typed() -> None:
    first, *_ = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    lines = [line.partition("#")[0].strip() for line in first.splitlines()]
    assert lines[0] == "make demo"
    assert ". .venv/bin/activate" in lines
    assert README.index(". .venv/bin/activate") < README.index("| `robrain ")
