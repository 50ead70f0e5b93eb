"""Programs of others that read recordings, from npm into the project's cache."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

CACHE = Path(__file__).parents[2] / ".cache"
INSTALL_S = 300


def absent(what: str) -> None:
    """Skip, or fail in CI, which must have everything."""
    if "CI" in os.environ:
        pytest.fail(f"there is no {what} here; CI must have it")
    pytest.skip(f"there is no {what} here")


def installed(name: str, packages: tuple[str, ...]) -> Path:
    """The folder that has these packages in its `node_modules`; where there is no npm the test is skipped.

    Args:
        name: of the folder in the cache.
        packages: with their versions, as npm writes them.
    """
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        absent("npm")
    folder = CACHE / name
    if not all((folder / "node_modules" / package.rpartition("@")[0]).is_dir() for package in packages):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text(f'{{"name": "{name}", "private": true}}')
        done = subprocess.run(
            [str(npm), "install", "--no-audit", "--no-fund", "--ignore-scripts", *packages],
            cwd=folder, capture_output=True, text=True, timeout=INSTALL_S, check=False,
        )  # fmt: skip
        if done.returncode:
            absent(f"way to install {', '.join(packages)} from npm ({done.stderr.strip()[-200:]})")
    return folder
