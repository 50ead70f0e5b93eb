"""Which files are mutated, and which mutants are drawn."""

import hashlib
import subprocess
from collections import Counter
from pathlib import Path

from tests.mutation.mutant import Mutant, mutants_of

PLACES = (
    "agent/",
    "coordinator/",
    "protocol/model/",
    "plugins/unit/",
    "plugins/skill/",
    "plugins/device/",
    "plugins/behavior/recharge.py",
)
NOT_YET = ("dashboard/",)  # tested in a browser, which is not done here


def files_in_scope(root: Path, places: tuple[str, ...] = PLACES) -> list[str]:
    """Tracked Python files in scope, without those left for later, sorted."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=root, capture_output=True, text=True, check=True)
    paths = listed.stdout.splitlines()
    return sorted(path for path in paths if path.startswith(places) and not path.startswith(NOT_YET))


def draw(root: Path, count: int, seed: int, places: tuple[str, ...] = PLACES) -> list[Mutant]:
    """Draw `count` mutants uniformly, or all if there are fewer.

    Each mutant's ticket is a hash of the seed and its name, and the lowest are drawn. An edit therefore changes only
    what is drawn of the lines that it touches, and what was killed once is tried again next time.
    """
    tickets: dict[Mutant, bytes] = {}
    named: Counter[str] = Counter()
    for path in files_in_scope(root, places):
        for mutant in mutants_of(root, path):
            text = f"{seed} {mutant.name} {named[mutant.name]}"
            named[mutant.name] += 1
            tickets[mutant] = hashlib.blake2b(text.encode(), digest_size=16).digest()
    return sorted(sorted(tickets, key=tickets.__getitem__)[:count])
