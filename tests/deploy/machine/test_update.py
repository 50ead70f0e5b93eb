"""Updates with packages made here: a healthy one is used, any other is taken back, whatever interrupts it."""

import ast
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from zipfile import ZipFile

import pytest

from robrain.deploy.machine import robrain_update
from robrain.deploy.machine.robrain_update import Machine, UpdateError
from tests.waiting import until

SCRIPT = Path(robrain_update.__file__)


def make_wheel(folder: Path, version: str, code: str) -> None:
    """A package `robrain` that does nothing but what `code` says."""
    info = f"robrain-{version}.dist-info"
    files = {
        "robrain_fake.py": f"def main():\n    {code}\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: robrain\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nrobrain = robrain_fake:main\n",
    }
    files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    with ZipFile(folder / f"robrain-{version}-py3-none-any.whl", "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheels")
    for version in ("1.0", "2.0"):
        make_wheel(folder, version, f"print('robrain {version}')")
    make_wheel(folder, "3.0", "raise SystemExit('broken')")
    return folder


@pytest.fixture
def pip(wheels: Path) -> tuple[str, ...]:
    return ("--no-index", "--find-links", str(wheels))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Restarts of units are written to a file."""
    log = tmp_path / "restarts"
    return Machine(tmp_path / "opt", ["sh", "-c", f'readlink {tmp_path}/opt/current >> {log}; echo "$@" >> {log}', "-"])


def restarts(machine: Machine) -> list[str]:
    log = machine.root.parent / "restarts"
    return log.read_text().splitlines() if log.exists() else []


def version_in_use(machine: Machine) -> str:
    return subprocess.check_output([machine.root / "current" / "bin" / "robrain", "--version"], text=True).strip()


def test_healthy_update_is_used_and_can_be_taken_back(machine: Machine, pip) -> None:
    assert machine.current == ""
    machine.install("robrain==1.0", pip, ["robrain-agent@r1"])
    assert (machine.current, version_in_use(machine)) == ("a", "robrain 1.0")
    state = machine.install("robrain==2.0", pip, ["robrain-agent@r1"], health="robrain plugin list r1")
    assert (machine.current, version_in_use(machine), state["state"]) == ("b", "robrain 2.0", "good")
    assert machine.back() == "a"
    assert version_in_use(machine) == "robrain 1.0"
    assert restarts(machine) == [
        word for slot in ("a", "b", "a") for word in (slot, "restart robrain-agent@r1")
    ]  # fmt: skip


def test_update_that_is_not_healthy_is_taken_back(machine: Machine, pip, monkeypatch) -> None:
    monkeypatch.setattr(robrain_update, "PAUSE_S", 0.01)
    machine.install("robrain==1.0", pip, ["u"])
    with pytest.raises(UpdateError, match=r"not healthy after 0\.05 s, so it was taken back: no robot"):
        machine.install("robrain==2.0", pip, ["u"], health="sh -c 'echo no robot; exit 3'", health_s=0.05)
    assert version_in_use(machine) == "robrain 1.0"
    assert machine.state()["state"] == "bad"
    assert restarts(machine)[-4:] == ["b", "restart u", "a", "restart u"]
    machine.install("robrain==2.0", pip)  # and may be tried again
    assert version_in_use(machine) == "robrain 2.0"


def test_health_check_is_repeated_until_it_succeeds(machine: Machine, pip, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(robrain_update, "PAUSE_S", 0.01)
    counter = tmp_path / "count"
    health = f"sh -c 'echo x >> {counter}; test $(wc -l < {counter}) -ge 3'"
    machine.install("robrain==1.0", pip, health=health, health_s=20.0)
    assert counter.read_text() == "x\n" * 3


@pytest.mark.parametrize("requirement", ["robrain==3.0", "robrain==9.9"])
def test_what_does_not_start_or_install_never_comes_into_use(machine: Machine, pip, requirement: str) -> None:
    machine.install("robrain==1.0", pip, ["u"])
    with pytest.raises(UpdateError, match=r"does not start: broken|cannot be installed"):
        machine.install(requirement, pip, ["u"])
    assert version_in_use(machine) == "robrain 1.0"
    assert restarts(machine) == ["a", "restart u"]


def test_unit_that_cannot_be_restarted_takes_the_update_back(tmp_path, pip, monkeypatch) -> None:
    machine = Machine(
        tmp_path / "opt", ["sh", "-c", 'test "$(readlink opt/current)" = a || { echo no bus; exit 1; }', "-"]
    )
    monkeypatch.chdir(tmp_path)
    machine.install("robrain==1.0", pip, ["u"])
    with pytest.raises(UpdateError, match="u cannot be restarted: no bus"):
        machine.install("robrain==2.0", pip, ["u"])
    assert version_in_use(machine) == "robrain 1.0"


def run(machine: Machine, *words: str, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), "--root", str(machine.root), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def test_kill_in_the_middle_is_taken_back_at_the_next_start(machine: Machine, pip) -> None:
    machine.install("robrain==1.0", pip)
    words = ["install", "robrain==2.0", "--pip", " ".join(pip), "--health", "sleep 60"]
    process = subprocess.Popen([sys.executable, str(SCRIPT), "--root", str(machine.root), *words])
    until(lambda: machine.current == "b", "the update never came so far")
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert json.loads(run(machine, "status").stdout)["last"]["state"] == "trying"
    refused = run(machine, "install", "robrain==2.0", "--pip", " ".join(pip))
    assert (refused.returncode, refused.stderr) == (
        1,
        "robrain-update: the last update was interrupted; run: robrain-update recover\n",
    )
    assert run(machine, "recover").stdout == "slot a is in use again\n"
    assert version_in_use(machine) == "robrain 1.0"
    assert run(machine, "recover").stdout == "nothing to take back\n"


def test_interrupt_takes_the_update_back(machine: Machine, pip) -> None:
    machine.install("robrain==1.0", pip)
    words = ["install", "robrain==2.0", "--pip", " ".join(pip), "--health", "sleep 60"]
    command = [sys.executable, str(SCRIPT), "--root", str(machine.root), *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until(lambda: machine.current == "b", "the update never came so far")
    time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 1
    assert "interrupted (KeyboardInterrupt); slot a is in use again" in said
    assert version_in_use(machine) == "robrain 1.0"


def test_two_updates_at_a_time_are_refused(machine: Machine) -> None:
    with machine.alone():
        refused = run(machine, "back")
    assert (refused.returncode, refused.stderr) == (1, "robrain-update: another update is running\n")


def test_first_update_that_fails_leaves_nothing_in_use(machine: Machine, pip) -> None:
    with pytest.raises(UpdateError, match="not healthy"):
        machine.install("robrain==1.0", pip, health="false", health_s=0.0)
    assert machine.current == ""
    with pytest.raises(UpdateError, match="has no robrain"):
        Machine(machine.root.parent / "empty").back()


def test_it_needs_nothing_but_the_standard_library() -> None:
    tree = ast.parse(SCRIPT.read_text())
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} <= set(sys.stdlib_module_names)
    assert os.access(SCRIPT, os.X_OK)
