"""The published JSON schemas of VDA 5050, for messages on MQTT. Nothing here is of the product."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator, FormatChecker

FOLDER = Path(__file__).parent / "schemas"


@cache
def validator(version: str, name: str) -> Draft202012Validator:
    """The schema of a topic."""
    schema = json.loads((FOLDER / version / f"{name}.json").read_text())
    return Draft202012Validator(schema, format_checker=FormatChecker())


def mistakes(version: str, topic: str, message: Any) -> list[str]:
    """What a message has that its schema forbids."""
    name = topic.rpartition("/")[2]
    return [f"{topic}: {error.json_path}: {error.message}" for error in validator(version, name).iter_errors(message)]
