"""A robot has the plain install: its agent runs without what the extras bring."""

import re
import subprocess
import sys

from robrain.cli import EXTRAS

WITHOUT_EXTRAS = (
    f"import sys; sys.modules.update(dict.fromkeys({sorted(EXTRAS)})); from robrain.cli import main; main()"
)


def test_agent_needs_no_extra(commands) -> None:
    arena = commands.start("arena", "arena_small", "--robots", "1", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    commands.line_with(arena, "arena: arena_small at ")
    agent = subprocess.Popen(
        [sys.executable, "-c", WITHOUT_EXTRAS, "agent", str(commands.folder / "r1.toml")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    commands.adopt(agent)
    line = commands.line_with(agent, "agent: r1 is up")
    assert re.fullmatch(r"agent: r1 is up with [1-9]\d plugins\n?", line)


def test_missing_extra_is_named(commands) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS, "run", "depot"], capture_output=True, text=True, check=False, timeout=30
    )
    assert done.returncode == 2
    assert "pip install 'robrain[sim]'" in done.stderr
    assert "Traceback" not in done.stderr
