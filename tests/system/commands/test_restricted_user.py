"""Commands of a user who may read everything and write nothing but the temporary folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PYTHON = Path(sys.executable)
IS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")


def run(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    may_read = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
    user = ("setpriv", "--reuid=12345", "--regid=12345", "--clear-groups", *may_read)
    return subprocess.run(
        [
            *user,
            "env",
            "-i",
            "PATH=/usr/bin:/bin",
            *(f"{name}={text}" for name, text in variables.items()),
            PYTHON,
            *words,
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@IS_ROOT
@pytest.mark.slow
@pytest.mark.parametrize("home", [{}, {"HOME": "/nonexistent"}, {"HOME": ""}])
def test_commands_work_or_say_what_they_need(tmp_path: Path, home: dict[str, str]) -> None:
    done = run(tmp_path, "-m", "robrain.cli", "scenarios", **home)
    assert (done.returncode, done.stderr) == (0, "")
    for words in (["demo", "--headless"], ["assistant"]):
        refused = run(tmp_path, "-m", "robrain.cli", *words, **home)
        assert refused.returncode == 2
        assert refused.stderr.startswith("robrain: ")
        assert refused.stderr.count("\n") == 1, refused.stderr
    assert list(tmp_path.iterdir()) == []


@IS_ROOT
@pytest.mark.slow
def test_kernels_are_stored_where_the_user_can_write(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    code = "import os; from robrain.protocol.model.slam import submap; print(os.environ['NUMBA_CACHE_DIR'])"
    assert run(tmp_path, "-c", code, HOME=str(tmp_path)).stdout.strip() == str(tmp_path / ".cache" / "robrain")
    assert run(tmp_path, "-c", code, TMPDIR=str(tmp_path)).stdout.strip() == str(tmp_path / "robrain-kernels-12345")
    assert not (tmp_path / "~").exists()
