"""Messages of a recording against the JSON Schema that each channel carries, by a validator that is not ours."""

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

from tests.system.npm_packages import installed
from tests.waiting import PATIENCE_S

AJV = "ajv@8.17.1"
PACKAGES = ("@mcap/core@2.2.2", "@mcap/nodejs@1.0.2", "@mcap/support@1.1.0", AJV)


def counts_by_ajv(path: Path) -> Counter[str]:
    """Messages by channel, found valid by ajv.

    Its strict mode refuses schemas with keywords that JSON Schema does not have.
    """
    found = json.loads(run_in_node("check_messages.mjs", PACKAGES, str(path)))
    assert found["invalid"] == []
    return Counter(found["counts"])


def run_in_node(script: str, packages: tuple[str, ...], *words: str, stdin: str = "") -> str:
    """What a script beside this file prints; it finds the packages, from npm, beside itself."""
    folder = installed(Path(script).stem, packages)
    copy = shutil.copy(Path(__file__).with_name(script), folder / script)
    done = subprocess.run(
        ["node", str(copy), *words], input=stdin, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
