"""`robrain wire` prints the whole wire, in formats that others can check."""

import json
import re

import jsonschema
import pytest
from typer.testing import CliRunner

from robrain.cli import all_commands
from robrain.protocol.table.topics import all_rows


def printed(wire_format):
    result = CliRunner().invoke(all_commands(), ["wire", "--format", wire_format])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def document():
    return json.loads(printed("jsonschema"))


def schemas_of(row):
    return [row[name] for name in ("message", "request", "reply") if row.get(name) is not None]


def references_in(value):
    if isinstance(value, dict):
        yield from ([value["$ref"]] if isinstance(value.get("$ref"), str) else [])
        value = list(value.values())
    if isinstance(value, list):
        for one in value:
            yield from references_in(one)


def resolve(document, reference):
    found = document
    for part in reference.removeprefix("#/").split("/"):
        found = found[part]
    return found


def test_each_key_of_the_table_is_printed_once(document):
    keys = [f"robrain/{{team}}/{row.pattern}" for row in all_rows()]
    told = [row["key"] for kind in ("topics", "queries", "tokens") for row in document[kind]]
    assert sorted(told) == sorted(keys)
    page = printed("markdown")
    for row in all_rows():
        assert len(re.findall(rf"^\| `{re.escape(row.pattern)}` \|", page, re.MULTILINE)) == 1


@pytest.mark.slow
def test_each_schema_is_one_and_refers_to_what_is_there(document):
    jsonschema.Draft202012Validator.check_schema({"$defs": document["$defs"]})
    for kind in ("topics", "queries"):
        for row in document[kind]:
            for schema in schemas_of(row):
                jsonschema.Draft202012Validator.check_schema(schema)
    for told in document:
        for reference in references_in(told):
            assert resolve(told, reference) is not None
