"""Commands of a user who may read everything and write nothing but the temporary folder, or not even that."""

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
IS_ROOT = pytest.mark.skipif(not MAY_MOUNT, reason="only root can become another user and mount")


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


READ_ONLY = "mount -o remount,bind,ro /"
SHARED_MEMORY = "mount -t tmpfs -o ro,size=4k tmpfs /dev/shm"
SURROUNDINGS = {
    "no HOME": ("true", {}),
    "HOME that is not there": ("true", {"HOME": "/nonexistent"}),
    "empty HOME": ("true", {"HOME": ""}),
    "no shared memory": (SHARED_MEMORY, {"HOME": "/nonexistent"}),
    "read-only root": (f"{SHARED_MEMORY} && {READ_ONLY}", {}),
}
WORK = ("scenarios", "wire", "info run.mcap", "check run.mcap", "diff run.mcap run.mcap", "plugin check .", "--help")
"""Commands that need nothing which is missing."""
REFUSE = (
    "demo --headless", "assistant", "status", "up arena_small", "pki init pki", "plugin new lamp", "machine-files out",
    "recover run.mcap", "report run.mcap", "export run.mcap",
    "sweep arena_small --vary seed=1,2 --time-limit 1", "journal restore a.journal --journal b.journal",
    "bringup r1.toml --yes", "run arena_small --time-limit 1 --record new.mcap", "arena arena_small --robot-files out",
    "coordinator --journal a.journal --listen tcp/127.0.0.1:0", "record -o new.mcap", "task list", "journal backup",
)  # fmt: skip
"""Commands that say what they need, a folder or a team."""
ALL = """
import importlib, json, os, signal, sys
from tests.system.prefork import run_main
importlib.import_module("robrain.cli")
for words in json.load(sys.stdin):
    output = os.memfd_create("output")
    pid = os.fork()
    if not pid:
        signal.alarm(200)
        os.setsid()
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording and a robot's file, which the user may read."""
    made = tmp_path_factory.mktemp("readable")
    words = ("run", "arena_small", "--robots", "1", "--time-limit", "1", "--record", "run.mcap", "--json")
    subprocess.run([PYTHON, "-m", "robrain.cli", *words], cwd=made, check=True, capture_output=True, timeout=300)
    (made / "r1.toml").write_text('[robot]\nname = "r1"\nload = ["mocdevice"]\n')
    return made


@IS_ROOT
@pytest.mark.slow
@pytest.mark.parametrize("what", SURROUNDINGS)
def test_commands_work_or_say_what_they_need(folder: Path, what: str) -> None:
    mounts, home = SURROUNDINGS[what]
    before = sorted(folder.rglob("*"))
    words = json.dumps([shlex.split(each) for each in (*WORK, *REFUSE)])
    done = run(folder, "-c", ALL, mounts=mounts, given=words, PYTHONPATH=str(ROOT), **home)
    assert done.returncode == 0, done.stderr
    found = [(" ".join(words), *rest) for words, *rest in map(json.loads, done.stdout.splitlines())]
    assert [command for command, _, _ in found] == [*WORK, *REFUSE]
    wrong = [each for each in found if each[0] in WORK and each[1] != 0]
    for command, status, printed in found:
        is_sentence = status in (1, 2) and printed.startswith("robrain: ") and printed.count("\n") == 1
        if command in REFUSE and not is_sentence:
            wrong.append((command, status, printed))
    assert not wrong
    assert sorted(folder.rglob("*")) == before


@IS_ROOT
@pytest.mark.slow
def test_kernels_are_stored_where_the_user_can_write(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    code = "import os; from robrain.protocol.model.slam import submap; print(os.environ['NUMBA_CACHE_DIR'])"
    assert run(tmp_path, "-c", code, HOME=str(tmp_path)).stdout.strip() == str(tmp_path / ".cache" / "robrain")
    assert run(tmp_path, "-c", code, TMPDIR=str(tmp_path)).stdout.strip() == str(tmp_path / "robrain-kernels-12345")
    assert not (tmp_path / "~").exists()
