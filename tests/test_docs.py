"""The documents say what the code does.

docs/reference/topics.md is generated; after a change of the topics: `python -m tests.test_docs > docs/reference/topics.md`.
"""

import re
import sys
from pathlib import Path
from types import NoneType
from typing import get_args, get_origin

import msgspec
import pytest

from robrain.agent.host import AgentHost, stock_place
from robrain.agent.manifest import find_manifests, read_manifest
from robrain.agent.robot_file import RobotFile, RobotTable
from robrain.protocol.can.frames import database
from robrain.protocol.wire.clock import VirtualClock, to_ns
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.wire.topic import JSON, Delivery, Query, Token, Topic
from robrain.protocol.wire.topics import PUBLISHED, ROBOT_CALL, TOPICS

ROOT = Path(__file__).parent.parent
TOPICS_PAGE = ROOT / "docs" / "reference" / "topics.md"

INTRODUCTION = """\
# Topics

Generated from `protocol/wire/topics.py` by `python -m tests.test_docs > docs/reference/topics.md`; do not edit.

Keys stand below `robrain/{team}/`. A *topic* is published, a *query* is answered, a *token* says that its owner is
there. *latest*: only the last sample of a key counts; *every*: each counts, none is sent again; *lossless*: in live,
the sender keeps so many samples, sends them again after a cut, and late joiners get them (in lockstep nothing is lost).
Payloads are JSON unless said otherwise.
"""

QUERIES = """\
Every query is answered: with its reply, or with `{"code", "message", "detail"}` as an error. An empty request counts as
`{}`. A request that is larger than a megabyte (unless said otherwise), does not decode, or holds a value that is out of
range is answered `bad_arguments`, and counted. *free JSON*: the two ends agree on the types, as for the arguments of a
plugin's function.
"""


def topics_table() -> str:
    """The topics, in markdown."""
    lines = [
        "| key | what | by | payload | rate | delivery | urgency | recorded |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for topic in PUBLISHED:
        rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz is not None else "–"
        recorded = "yes" if topic.recorded else "–"
        payload, delivery = _payload(topic), _delivery(topic)
        cells = (f"`{topic.pattern}`", topic.doc, topic.by, payload, rate, delivery, topic.urgency, recorded)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def queries_table() -> str:
    """The queries, in markdown."""
    lines = ["| key | what | by | request | reply | changes something |", "|---|---|---|---|---|---|"]
    for row in TOPICS:
        if isinstance(row, Query):
            changes = "–" if row.reads_only else "yes"
            reply = _type(row.reply) if row.encoding == JSON else row.encoding
            cells = (f"`{row.pattern}`", row.doc, row.by, _type(row.request), reply, changes)
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def tokens_table() -> str:
    """The tokens, in markdown."""
    rows = [f"| `{row.pattern}` | {row.doc} | {row.by} |\n" for row in TOPICS if isinstance(row, Token)]
    return "| key | what | by |\n|---|---|---|\n" + "".join(rows)


def messages_table() -> str:
    """The messages, requests and replies with their fields, in markdown; those with a default are in italics."""
    lines = ["| message | fields |", "|---|---|"]
    said = [topic.message for topic in PUBLISHED]
    said += [kind for row in TOPICS if isinstance(row, Query) for kind in (row.request, row.reply)]
    structs = [one for kind in said for one in (kind, *get_args(kind)) if hasattr(one, "__struct_fields__")]
    for message in dict.fromkeys(structs):
        fields = (_field(field) for field in msgspec.structs.fields(message))
        lines.append(f"| `{message.__name__}` | {', '.join(fields)} |")
    return "\n".join(lines) + "\n"


def topics_page() -> str:
    """The whole of docs/reference/topics.md."""
    about = "Fields in italics have a default. Their meaning is in `protocol/wire/messages.py`."
    parts = (
        INTRODUCTION,
        topics_table(),
        f"## Queries\n\n{QUERIES}",
        queries_table(),
        "## Tokens\n",
        tokens_table(),
        f"## Messages\n\n{about}\n",
        messages_table(),
    )
    return "\n".join(parts)


def _field(field: msgspec.structs.FieldInfo) -> str:
    return f"`{field.name}`" if field.required else f"*{field.name}*"


def _payload(topic: Topic) -> str:
    if topic.encoding != JSON:
        return topic.encoding.removeprefix("application/vnd.robrain.")
    return f"`{topic.message.__name__}`" if topic.message is not None else "–"


def _type(kind: object) -> str:
    if kind is bytes:
        return "free JSON"
    if kind is NoneType:
        return "–"
    inner = get_args(kind)
    if get_origin(kind) is list:
        return f"list of {_type(inner[0])}"
    if get_origin(kind) is dict:
        return "object of numbers"
    return f"{_type(inner[0])} or null" if inner else f"`{kind.__name__}`"


def _delivery(topic: Topic) -> str:
    words = [f"{topic.delivery}, {topic.cache}" if topic.delivery is Delivery.LOSSLESS else str(topic.delivery)]
    words += ["waits where the network is congested"] * topic.is_blocking
    words += [f"at most {topic.max_bytes} bytes"] * (topic.max_bytes is not None)
    return "; ".join(words)


def test_topics_page_is_what_the_table_says() -> None:
    assert TOPICS_PAGE.read_text(encoding="utf-8") == topics_page(), "python -m tests.test_docs > docs/reference/topics.md"


@pytest.mark.parametrize("message", database().messages, ids=lambda message: message.name)
def test_conventions_have_each_can_frame(message) -> None:
    rows = [re.split(r" *\| *", line) for line in _lines("docs/reference/conventions.md") if line.startswith("| 0x")]
    row = next(row for row in rows if row[2] == message.name)
    assert int(row[1], 16) == message.frame_id
    assert int(row[3]) == message.length


def test_plugin_of_the_contributing_page_runs(tmp_path: Path) -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for language, name in (("python", "greeter.py"), ("toml", "greeter.toml")):
        block = re.search(rf"^```{language}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
        assert block is not None
        (tmp_path / name).write_text(block[1], encoding="utf-8")
    clock = VirtualClock()
    robot_file = RobotFile(robot=RobotTable("r1", places=[str(tmp_path)], load=["greeter"]))
    with open_lockstep_session() as session:
        operator = Endpoint(session, "default", clock, Drive.LOCKSTEP)
        host = AgentHost(robot_file, Path(), session, clock, Drive.LOCKSTEP)
        try:
            host.start()
            for second in range(3):
                clock.advance_to(to_ns(second))
                host.step()
            said = operator.ask(ROBOT_CALL, ["Ada"], robot="r1", plugin="greeter", function="hello")
        finally:
            host.close()
            operator.close()
    assert msgspec.json.decode(said) == "hello Ada, up for 3 s"
    assert said.decode() in page


@pytest.mark.parametrize("record", sorted((ROOT / "docs" / "decisions").glob("*.md")), ids=lambda path: path.stem)
def test_decision_is_short_and_complete(record: Path) -> None:
    text = record.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    assert text.startswith(f"# {record.stem[:4]} ")
    for part in ("Context", "Decision", "Measurement", "Consequence"):
        assert re.search(rf"^\*\*{part}", text, re.MULTILINE), part


def test_decisions_are_numbered_without_gaps() -> None:
    numbers = sorted(int(path.name[:4]) for path in (ROOT / "docs" / "decisions").glob("*.md"))
    assert numbers == list(range(1, len(numbers) + 1))


def test_drawing_of_the_robot_has_the_arrows_of_the_manifests() -> None:
    drawn = set()
    for line in _lines("ARCHITECTURE.md"):
        if arrow := re.fullmatch(r" +(\w+) --> (\w+(?: & \w+)*)", line):
            drawn |= {(arrow[1], callee) for callee in arrow[2].split(" & ")}
    manifests = [read_manifest(path) for path in find_manifests(stock_place())]
    assert drawn == {(manifest.name, required) for manifest in manifests for required in manifest.tag.requires}


def _lines(path: str) -> list[str]:
    return (ROOT / path).read_text(encoding="utf-8").splitlines()


if __name__ == "__main__":
    sys.stdout.write(topics_page())
