"""The versions that decide what a run does, as a manifest names them."""

import subprocess
from pathlib import Path

from robrain.coordinator.recording.writer.provenance import software_versions

SOURCES = Path(__file__).resolve().parents[2]
MORE_PACKAGES = ("scipy", "numba")


def all_versions() -> dict[str, str]:
    """Versions of Python, robrain and the packages behind a digest, and the revision of the sources if git knows it."""
    return {**software_versions(MORE_PACKAGES), **revision()}


def revision() -> dict[str, str]:
    """The commit that the sources are at, with `+` if files differ; nothing for an installed package."""
    if not (SOURCES / ".git").exists():
        return {}
    try:
        commit = _git("rev-parse", "HEAD")
        is_changed = bool(_git("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.CalledProcessError):
        return {}
    return {"revision": commit + ("+" if is_changed else "")}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=SOURCES, capture_output=True, text=True, check=True).stdout.strip()
