"""What a person sees of a check: findings in the file, and how the invariants of the run stand."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from robrain.deploy.command_line.terminal import results
from robrain.deploy.recordings.recording_display import said
from robrain.recording.invariants.findings import InvariantState, Ruling
from robrain.recording.invariants.judging import broken
from robrain.recording.invariants.words import INVARIANTS, cases_text
from robrain.recording.reader.checking import Severity, Verdict


def show_verdict(verdict: Verdict) -> None:
    """What a check found."""
    console = results()
    if verdict.findings:
        _show_findings(console, verdict)
    _show_invariants(console, verdict.invariants)
    result = Text("good") if verdict.good else Text("not good", "red")
    counted = f"{verdict.messages} messages, {verdict.problems} problems, {verdict.notes} notes"
    if count := broken(verdict.invariants):
        counted += f", {count} {'invariant' if count == 1 else 'invariants'} broken"
    console.print(Text.assemble(f"{said(verdict.path)}: ", result, f", {counted}"), soft_wrap=True)


def _show_findings(console: Console, verdict: Verdict) -> None:
    table = Table(box=None, pad_edge=False)
    for heading in ("", "what", "at", "key", "found"):
        table.add_column(heading, overflow="fold")
    for finding in verdict.findings:
        color = "red" if finding.severity is Severity.PROBLEM else "yellow"
        row = (f"{finding.time_s:.3f} s", finding.key, finding.text)
        table.add_row(Text(finding.severity, color), finding.kind.replace("_", " "), *map(said, row))
    console.print(table)
    for kind, count in verdict.more.items():
        console.print(f"and {count} more of {kind.replace('_', ' ')}")
    console.print()


def _show_invariants(console: Console, rulings: list[Ruling]) -> None:
    table = Table(box=None, pad_edge=False)
    for heading in ("invariant", "", "cases"):
        table.add_column(heading, overflow="fold")
    for ruling in rulings:
        table.add_row(INVARIANTS[ruling.invariant], *_standing(ruling))
    console.print(table)
    for ruling in rulings:
        if ruling.breaches:
            console.print(Text.assemble("\n", (INVARIANTS[ruling.invariant], "red"), ": broken"), soft_wrap=True)
        for breach in ruling.breaches:
            console.print(f"  {said(breach.text)}", soft_wrap=True)
        if ruling.more:
            console.print(f"  and {ruling.more} more")
    console.print()


def _standing(ruling: Ruling) -> tuple[Text, str]:
    cases = cases_text(ruling.invariant, ruling.cases)
    match ruling.standing:
        case InvariantState.KEPT:
            return Text("kept", "green"), cases
        case InvariantState.BROKEN:
            return Text(f"broken ({ruling.broken})", "red"), cases
        case InvariantState.NOT_JUDGED:
            return Text("not judged", "yellow"), ruling.why
