"""Simulates the plain install: packages from extras or for tests cannot be imported."""

import json
import os
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.product import FOLDERS, ROOT

FRESH = ("pip", "setuptools")
"""Distributions of a new environment."""
BLOCKS_PER_MB = 2048
"""Of 512 bytes, as `du -m` counts."""

BLOCKER = """
import sys

class Blocker:
    blocked = frozenset({blocked})

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.blocked:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocker())
"""


def plain_python_path(folder: Path) -> str:
    """A PYTHONPATH that limits Python to what `pip install robrain` installs."""
    blocked = sorted(set(metadata.packages_distributions()) - plain_packages() - {"robrain"})
    (folder / "sitecustomize.py").write_text(BLOCKER.format(blocked=json.dumps(blocked)))
    return os.pathsep.join((str(folder), str(ROOT)))  # this tree's robrain, wherever another one is installed


def plain_distributions() -> set[str]:
    """Canonical names of the distributions that `pip install robrain` installs, without robrain itself."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    open_requirements = [Requirement(text) for text in project["dependencies"]]
    distributions: set[str] = set()
    while open_requirements:
        name = canonicalize_name(open_requirements.pop().name)
        if name in distributions:
            continue
        distributions.add(name)
        wanted = map(Requirement, metadata.requires(name) or [])
        open_requirements += [one for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    return distributions


def plain_size_mb() -> float:
    """What a new environment with the plain install takes on disk: these distributions, robrain, pip and setuptools."""
    files = {Path(str(file.locate())) for name in (*plain_distributions(), *FRESH) for file in _files(name)}
    own = {path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix not in (".nbi", ".nbc")}
    blocks = sum(path.stat().st_blocks for path in (*files, *own) if path.is_file())
    return blocks / BLOCKS_PER_MB


def _files(distribution: str) -> list[metadata.PackagePath]:
    return list(metadata.files(distribution) or [])


def plain_packages() -> set[str]:
    """Import names of the plain install's distributions."""
    distributions = plain_distributions()
    return {
        package
        for package, brought_by in metadata.packages_distributions().items()
        if any(canonicalize_name(name) in distributions for name in brought_by)
    }
