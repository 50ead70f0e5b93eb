"""Simulates the plain install: packages from extras or for tests cannot be imported."""

import json
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.system.conftest import ROOT

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
    return str(folder)


def plain_packages() -> set[str]:
    """Import names of the plain install's distributions."""
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
    return {
        package
        for package, brought_by in metadata.packages_distributions().items()
        if any(canonicalize_name(name) in distributions for name in brought_by)
    }
