"""Display of a recording in the terminal. Tables are results and go to stdout; progress goes to stderr.

Every text out of a recording passes `safe_text`.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from robrain.deploy.command_line.terminal import console, new_table, print_line, results, text_column
from robrain.protocol.safe_text import safe_text
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.invariants.invariant import InvariantState, Ruling
from robrain.recording.invariants.judging import broken
from robrain.recording.reader.checking import Severity, Verdict
from robrain.recording.reader.contents import KeyContents, RecordingContents
from robrain.recording.reader.recovering import Recovery
from robrain.recording.reader.two_runs import ComparedRow, Difference, TwoRuns, text_of
from robrain.recording.writer.recorder import Recorder, RecordingSummary

TEXT_SHOWN = 500
FOLDED_ABOVE = 16
"""Number of keys of one topic above which they are listed together."""


def shown(text: object, limit: int = TEXT_SHOWN) -> str:
    """A text from elsewhere as a terminal may have it."""
    return safe_text(str(text), limit)


@contextmanager
def progress(what: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A bar that receives the share that is done; it leaves nothing on a stream that is no terminal."""
    columns = (text_column("{task.description}"), BarColumn(bar_width=30), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as bars:
        bar = bars.add_task(what, total=1.0)
        yield lambda share: bars.update(bar, completed=share)


@contextmanager
def record_display(path: Path, *, quiet: bool = False) -> Iterator[Callable[[Recorder], None]]:
    """A line on how a recorder does, redrawn in a terminal."""
    if not quiet:
        console.print(f"recording to {shown(path)}; Ctrl-C ends it", soft_wrap=True)
    columns = (text_column("{task.description}"), text_column("{task.fields[lost]}", "red"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as bars:
        bar = bars.add_task("", lost="")

        def show(recorder: Recorder) -> None:
            lost = f"{recorder.lost} lost" if recorder.lost else ""
            name = shown(recorder.paths[-1].name) if recorder.paths else ""
            words = f"{name}: {recorder.messages} messages, {_bytes(recorder.size_bytes)}"
            bars.update(bar, description=words, lost=lost)

        yield show


def show_recorded(summary: RecordingSummary) -> None:
    """Files, messages and losses of a recording."""
    files = ", ".join(map(str, summary.paths))
    print_line(f"{files}: {summary.messages} messages, {_bytes(summary.bytes)}")
    if summary.removed:
        print_line(f"{summary.removed} older files were removed to make room")
    for topic, messages in sorted(summary.lost_by_topic.items()):
        results().print(Text.assemble(("lost", "red"), f": {messages} of {shown(topic)}"), soft_wrap=True)


def show_contents(contents: RecordingContents, *, every_key: bool = False) -> None:
    """Where a recording comes from, and a line for each key; many of one topic have one together, unless asked for."""
    console = results()
    info = contents.info
    _line(
        console, "file", f"{info.path}, {_bytes(info.size_bytes)}" + (", its end is missing" if info.truncated else "")
    )
    _line(console, "length", f"{info.duration_s:.2f} s, {info.messages} messages")
    if contents.keys and not any(key.topic or is_visual(key.key) for key in contents.keys):
        _line(console, "origin", "another program: no key is a topic of robrain")
    origins = {"run": contents.run, "host": contents.host, "versions": contents.versions, "recorder": contents.summary}
    for name, values in origins.items():
        if values:
            _line(console, name, ", ".join(f"{key} {value}" for key, value in values.items() if value))
    attached = [f"{key} ({_bytes(size)})" for key, size in contents.attachments.items()]
    attached += [f"{len(contents.manifests)} manifests"] if contents.manifests else []
    if attached:
        _line(console, "attached", ", ".join(attached))
    numbers = ("messages", "rate", "bytes", "first", "last", "longest gap", "at", "gaps", "missing")
    table = new_table("key", *numbers, right=numbers)
    for key in contents.keys if every_key else folded(contents.keys):
        table.add_row(*_contents_row(key))
    console.print()
    console.print(table)


def show_difference(first: Path, second: Path, difference: Difference | None, same: int) -> None:
    """First difference of two runs."""
    lines = [f"equal: {same} messages"] if difference is None else where_different(first, second, difference)
    for line in lines:
        print_line(line)


def where_different(first: Path, second: Path, difference: Difference) -> list[str]:
    """The first difference of two runs, and the values of each there: three lines."""
    what = f"{difference.what} {difference.path}" if difference.path else difference.what
    lines = [
        f"message {difference.number} differs, at {difference.time_s:.3f} s, on {difference.key}, in its {what}",
        f"  {first}: {difference.first}",
        f"  {second}: {difference.second}",
    ]
    return [safe_text(line, TEXT_SHOWN) for line in lines]


def show_recovery(recovery: Recovery) -> None:
    """Result of a recovery."""
    print_line(
        f"{recovery.path}: {recovery.messages} messages, {_bytes(recovery.bytes)}; "
        f"{recovery.damaged_chunks} damaged chunks left out, {recovery.unread_bytes} bytes at the end unreadable"
    )


def show_files(files: list[Path]) -> None:
    """Result of an export."""
    for path in files:
        print_line(f"{path}, {_bytes(path.stat().st_size)}")


def _contents_row(key: KeyContents) -> tuple[str, ...]:
    return (
        shown(key.key),
        str(key.messages),
        f"{key.rate_hz:.2f} Hz" if key.rate_hz else "–",
        _bytes(key.bytes),
        f"{key.first_s:.2f} s",
        f"{key.last_s:.2f} s",
        f"{key.longest_gap_s:.2f} s",
        f"{key.longest_gap_at_s:.2f} s",
        str(key.gaps),
        str(key.missing),
    )


def _line(console: Console, name: str, text: str) -> None:
    console.print(Text.assemble((f"{name:<9}", "bold"), shown(text)), soft_wrap=True)


def _bytes(size: int) -> str:
    if size < 10_000:
        return f"{size} B"
    return f"{size / 1000:.1f} kB" if size < 1_000_000 else f"{size / 1_000_000:.1f} MB"


def folded(keys: list[KeyContents]) -> list[KeyContents]:
    """Keys by name, those of the wire first; many keys of one topic as one, `task/event/* (97 keys)`.

    For folded keys, the silence is that of the key that was silent longest, and the rate is that of all together.
    """
    by_topic: defaultdict[str, list[KeyContents]] = defaultdict(list)
    for key in keys:
        by_topic[key.topic or key.key].append(key)
    lines: list[KeyContents] = []
    for together in by_topic.values():
        lines += [_one(together)] if len(together) > FOLDED_ABOVE else together
    return sorted(lines, key=lambda line: (is_visual(line.key), line.key))


def _one(keys: list[KeyContents]) -> KeyContents:
    chunks = zip(*(key.key.split("/") for key in keys), strict=False)
    name = "/".join(alike[0] if len(set(alike)) == 1 else "*" for alike in chunks)
    silent = max(keys, key=lambda key: key.longest_gap_s)
    first_s, last_s = min(key.first_s for key in keys), max(key.last_s for key in keys)
    messages = sum(key.messages for key in keys)
    return msgspec.structs.replace(
        silent,
        key=f"{name} ({len(keys)} keys)",
        messages=messages,
        bytes=sum(key.bytes for key in keys),
        first_s=first_s,
        last_s=last_s,
        rate_hz=(messages - 1) / (last_s - first_s) if last_s > first_s else 0.0,
        gaps=sum(key.gaps for key in keys),
        missing=sum(key.missing for key in keys),
    )


NAME_SHOWN = 40


def show_two_runs(runs: TwoRuns) -> None:
    """Print the table of two runs: the run, explored shares, each robot, each task; equal lines are dim."""
    names = [shown(run.recording.stem, NAME_SHOWN) for run in (runs.first, runs.second)]
    table = new_table("", "", *names, "difference", right=[*names, "difference"])
    before = ""
    for row in runs.rows:
        if row.group != before and before:
            table.add_section()
        group = row.group if row.group != before else ""
        before = row.group
        table.add_row(shown(group), *_cells(row), style="dim" if row.is_equal else "")
    results().print(table)


def _cells(row: ComparedRow) -> tuple[str, str, str, str]:
    first, second, difference = text_of(row)
    return shown(row.name, NAME_SHOWN), shown(first), shown(second), shown(difference)


def show_verdict(verdict: Verdict) -> None:
    """Result of a check."""
    console = results()
    if verdict.findings:
        _show_findings(console, verdict)
    _show_invariants(console, verdict.invariants)
    result = Text("good") if verdict.good else Text("not good", "red")
    counted = f"{verdict.messages} messages, {verdict.problems} problems, {verdict.remarks} notes"
    if count := broken(verdict.invariants):
        counted += f", {count} {'invariant' if count == 1 else 'invariants'} broken"
    console.print(Text.assemble(f"{shown(verdict.path)}: ", result, f", {counted}"), soft_wrap=True)


def _show_findings(console: Console, verdict: Verdict) -> None:
    table = new_table("", "what", "at", "key", "found")
    for finding in verdict.findings:
        color = "red" if finding.severity is Severity.PROBLEM else "yellow"
        row = (f"{finding.time_s:.3f} s", finding.key, finding.text)
        table.add_row(Text(finding.severity, color), finding.kind.replace("_", " "), *map(shown, row))
    console.print(table)
    for kind, count in verdict.more.items():
        console.print(f"and {count} more of {kind.replace('_', ' ')}")
    console.print()


def _show_invariants(console: Console, rulings: list[Ruling]) -> None:
    table = new_table("invariant", "", "cases")
    for ruling in rulings:
        table.add_row(ruling.invariant.words, *_verdict(ruling))
    console.print(table)
    for ruling in rulings:
        if ruling.breaches:
            console.print(Text.assemble("\n", (ruling.invariant.words, "red"), ": broken"), soft_wrap=True)
        for breach in ruling.breaches:
            print_line(f"  {shown(breach.text)}")
        if ruling.more:
            print_line(f"  and {ruling.more} more")
    console.print()


def _verdict(ruling: Ruling) -> tuple[Text, str]:
    match ruling.state:
        case InvariantState.KEPT:
            return Text("kept", "green"), ruling.cases_text
        case InvariantState.BROKEN:
            return Text(f"broken ({ruling.broken})", "red"), ruling.cases_text
        case InvariantState.NOT_JUDGED:
            return Text("not judged", "yellow"), ruling.reason
