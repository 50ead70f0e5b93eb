"""Messages of a recording against the JSON Schema that each channel carries, by two validators."""

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from tests.system.npm_packages import installed
from tests.waiting import PATIENCE_S

AJV = "ajv@8.17.1"
OFTEN, EVERY = 20, 10
"""Of a channel with more messages than this jsonschema, which is slow, looks at each so manieth; ajv looks at all."""
PACKAGES = ("@mcap/core@2.2.2", "@mcap/nodejs@1.0.2", "@mcap/support@1.1.0", AJV)


def counts_by_jsonschema(path: Path) -> Counter[str]:
    """Messages by channel, which were found valid; AssertionError names the first that is not."""
    validators: dict[str, Draft202012Validator] = {}
    counts: Counter[str] = Counter()
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            text = channel.metadata.get("json_schema")
            if text is None:
                continue
            if text not in validators:
                Draft202012Validator.check_schema(json.loads(text))
                validators[text] = Draft202012Validator(json.loads(text))
            counts[channel.topic] += 1
            if counts[channel.topic] > OFTEN and counts[channel.topic] % EVERY:
                continue
            error = next(validators[text].iter_errors(json.loads(message.data)), None)
            assert error is None, f"{channel.topic}: {error.json_path}: {error.message[:500]}"
    return counts


def counts_by_ajv(path: Path) -> Counter[str]:
    """The same, by ajv in its strict mode, which refuses schemas with keywords that JSON Schema does not have."""
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
