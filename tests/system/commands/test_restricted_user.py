"""Commands of a user who may read everything and write nothing."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

PYTHON = Path(sys.executable)
ROOT = Path(__file__).parents[3]
MAY_MOUNT = os.geteuid() == 0 and not subprocess.run(["unshare", "-m", "true"], check=False).returncode
pytestmark = pytest.mark.skipif(not MAY_MOUNT, reason="only root can become another user and mount")
READ_ONLY = "mount -t tmpfs -o ro,size=4k tmpfs /dev/shm && mount -o remount,bind,ro /"
WORK = ("scenarios", "info run.mcap", "--help")
REFUSE = (
    "demo --headless", "assistant", "status", "pki init pki", "plugin new lamp --level unit", "machine-files out",
    "recover run.mcap", "journal restore a.journal --journal b.journal", "shell r1",
    "run arena_small --time-limit 1 --record new.mcap", "coordinator --journal a.journal --listen tcp/127.0.0.1:0",
    "report run.mcap", "check run.mcap",
)  # fmt: skip
"""Commands that say which folder, or which team, they need."""
ALL = """
import json, os, sys
from tests.system.prefork import run_main
import robrain.cli
for words in json.load(sys.stdin):
    output = os.memfd_create("output")
    pid = os.fork()
    if not pid:
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.argv = ["robrain", *words]
        status = run_main()
        sys.stdout.flush()
        os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    os.lseek(output, 0, os.SEEK_SET)
    print(json.dumps([words, status, os.read(output, 1 << 20).decode()]), flush=True)
"""
"""Runs commands, each in a forked process, and prints what each printed."""


def run(
    folder: Path, *words: str, mounts: str = "true", given: str = "", **variables: str
) -> subprocess.CompletedProcess[str]:
    may_read = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
    user = ("setpriv", "--reuid=12345", "--regid=12345", "--clear-groups", *may_read)
    return subprocess.run(
        [
            *("unshare", "-m", "sh", "-c", f'{mounts} && exec "$@"', "sh"),
            *user,
            "env",
            "-i",
            "PATH=/usr/bin:/bin",
            *(f"{name}={text}" for name, text in variables.items()),
            PYTHON,
            *words,
        ],
        cwd=folder,
        input=given,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def readable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording that the user may read."""
    folder = tmp_path_factory.mktemp("readable")
    folder.chmod(0o755)
    words = ("run", "arena_small", "--robots", "1", "--time-limit", "0.2", "--record", "run.mcap", "--json")
    subprocess.run([PYTHON, "-m", "robrain.cli", *words], cwd=folder, check=True, capture_output=True, timeout=300)
    return folder


@pytest.mark.slow
def test_commands_work_or_say_what_they_need_on_a_read_only_root_without_home(readable: Path) -> None:
    before = sorted(readable.rglob("*"))
    commands = [*WORK, *REFUSE]
    given = json.dumps([shlex.split(each) for each in commands])
    done = run(readable, "-c", ALL, mounts=READ_ONLY, given=given, PYTHONPATH=str(ROOT), HOME="/nonexistent")
    assert done.returncode == 0, done.stderr
    answers = map(json.loads, done.stdout.splitlines())
    found = {shlex.join(words): (status, printed) for words, status, printed in answers}
    assert list(found) == commands
    assert {command: found[command] for command in WORK if found[command][0] != 0} == {}
    sentences = {
        command: status == 2 and printed.splitlines()[-1].startswith("robrain: ") and "Traceback" not in printed
        for command, (status, printed) in found.items()
        if command not in WORK
    }
    assert [found[command] for command, is_sentence in sentences.items() if not is_sentence] == []
    assert sorted(readable.rglob("*")) == before


@pytest.mark.slow
def test_kernels_are_stored_where_the_user_can_write(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    code = "import os; from robrain.algorithms.slam import submap; print(os.environ['NUMBA_CACHE_DIR'])"
    assert run(tmp_path, "-c", code, HOME=str(tmp_path)).stdout.strip() == str(tmp_path / ".cache" / "robrain")
    assert run(tmp_path, "-c", code, TMPDIR=str(tmp_path)).stdout.strip() == str(tmp_path / "robrain-kernels-12345")
    assert not (tmp_path / "~").exists()
