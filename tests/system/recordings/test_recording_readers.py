"""Recordings, recovered ones too, are read by others than us: the official TypeScript reader, and Rerun's checker.

The TypeScript reader comes from npm into the project's cache. Where there is no npm the test is skipped, and fails
where `CI` is set.
"""

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from robrain.recording.reader.reading import read_messages
from robrain.recording.reader.recovering import recover, with_visual
from tests.system.npm_packages import absent, installed
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

PACKAGES = ("@mcap/core@2.2.2", "@mcap/nodejs@1.0.2", "@mcap/support@1.1.0")
SCRIPT = Path(__file__).with_name("read_mcap.mjs")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory, depot_run: Path) -> list[Path]:
    """A whole recording, one that was cut off and recovered, and one with a damaged chunk, recovered."""
    folder = tmp_path_factory.mktemp("readers")
    content = depot_run.read_bytes()
    (folder / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    damaged = bytearray(content)
    damaged[damaged.rindex(b"\x28\xb5\x2f\xfd", 0, len(damaged) // 2) + 30] ^= 0xFF
    (folder / "damaged.mcap").write_bytes(damaged)
    paths = [depot_run]
    for name in ("cut", "damaged"):
        paths.append(folder / f"{name}_recovered.mcap")
        recover(folder / f"{name}.mcap", paths[-1])
    paths.append(folder / "drawn.mcap")
    with_visual(depot_run, paths[-1])
    return paths


@pytest.fixture(scope="module")
def typescript() -> Path:
    """The script, where it finds the reader's packages."""
    folder = installed("mcap-reader", PACKAGES)
    # Modules are looked for beside the script.
    return Path(shutil.copy(SCRIPT, folder / SCRIPT.name))


def read_with_typescript(script: Path, paths: list[Path]) -> list[dict[str, Any]]:
    done = subprocess.run(
        ["node", str(script), *map(str, paths)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_the_official_typescript_reader_counts_what_we_count(typescript: Path, recordings: list[Path]) -> None:
    for found, path in zip(read_with_typescript(typescript, recordings), recordings, strict=True):
        messages = list(read_messages(path))
        assert found["counts"] == Counter(message.topic_key for message in messages)
        assert found["bytes"] == sum(len(message.payload) for message in messages)
        assert found["metadata"]["robrain.run"]["scenario"] == "depot"
        assert found["attachments"]["scenario.toml"] > 0


def test_rerun_finds_nothing_wrong(recordings: list[Path], tmp_path: Path) -> None:
    rerun = Path(sys.executable).with_name("rerun")
    if not rerun.exists():
        absent("rerun")
    # Its settings, and whether it may report on its use, belong to a folder of this test.
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    subprocess.run(
        [rerun, "analytics", "disable"], env=environment, capture_output=True, timeout=PATIENCE_S, check=False
    )
    for path in recordings:
        done = subprocess.run(
            [rerun, "mcap", "check", "--full", str(path)],
            env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        lines = [line for line in done.stdout.splitlines() if line.startswith(("ok", "warn", "err", "fail"))]
        channels = {message.topic_key for message in read_messages(path)}
        assert len(lines) >= len(channels)
        assert all(line.startswith("ok") for line in lines), done.stdout
