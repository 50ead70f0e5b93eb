"""Writes the tables of figures in the pages from docs/figures/bench.json.

`make figures` (`python -m tests.bench.tables`) replaces each block `<!-- figures: NAME -->` … `<!-- /figures -->` of
the pages. NAME is a section of `make bench`, `summary` or `misses`. A test checks that blocks and JSON agree.
"""

import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from robrain.lab.bench.figure import Figure, FigureKind
from tests.bench.judging import Known, judge, read_known
from tests.bench.results import ROOT, Conditions, Results, ResultsError
from tests.bench.sections import SECTIONS

PAGES = ROOT / "docs"
BLOCK = re.compile(r"^<!-- figures: (?P<name>\w+) -->\n(?P<body>.*?)^<!-- /figures -->$", re.DOTALL | re.MULTILINE)
MARKER = re.compile(r"^ *<!-- /?figures\b.*$", re.MULTILINE)
KEPT_WORDS = {True: "yes", False: "**no**", None: ""}


class PageError(Exception):
    """A page's blocks cannot be written; the text says which and why."""


def blocks(text: str) -> dict[str, str]:
    """The bodies of a page's blocks by name (PageError if markers are not paired, or a name comes twice)."""
    found = [(match["name"], match["body"]) for match in BLOCK.finditer(text)]
    if len(MARKER.findall(text)) != 2 * len(found):
        raise PageError("expected pairs of `<!-- figures: NAME -->` and `<!-- /figures -->`")
    names = [name for name, _ in found]
    if len(set(names)) != len(names):
        raise PageError(f"expected each block once, got {', '.join(names)}")
    return dict(found)


def filled(text: str, results: Results, known: Known) -> str:
    """The page with its blocks written from the results (PageError for an unknown name)."""
    blocks(text)
    return BLOCK.sub(
        lambda match: f"<!-- figures: {match['name']} -->\n{block(match['name'], results, known)}<!-- /figures -->",
        text,
    )


def block(name: str, results: Results, known: Known) -> str:
    """The body of one block."""
    others: dict[str, Callable[[Results, Known], str]] = {"summary": summary, "misses": misses}
    if name in others:
        return others[name](results, known)
    if name not in SECTIONS:
        raise PageError(f"{name}: expected summary, misses or a section: {', '.join(SECTIONS)}")
    if name not in results.sections:
        return f"{SECTIONS[name].about}\n\nNot measured: {known.unmeasured.get(name, 'not known why')}.\n"
    return section_table(name, results)


def section_table(name: str, results: Results) -> str:
    """One section's figures."""
    result = results.sections[name]
    rows = [
        (figure.name, figure.value_text(), figure.bound_text(), _kept_words(figure, result.measured), figure.beside)
        for figure in result.figures
    ]
    about = f"{SECTIONS[name].about} {_when(result.measured)}."
    return f"{about}\n\n{_table(('figure', 'measured', 'bound', 'kept', 'beside'), rows)}"


def summary(results: Results, known: Known) -> str:
    """Numbers of figures and of bounds kept, and the machine of the measurement."""
    figures = results.named()
    verdict = judge(figures, known.misses, results.busy)
    bounded = sum(figure.kept is not None for figure in figures.values())
    fixed = sum(figure.kind is FigureKind.DETERMINISTIC for figure in figures.values())
    machines = sorted({result.measured.machine.words() for result in results.sections.values()})
    took_min = sum(result.measured.took_s for result in results.sections.values()) / 60
    return (
        f"{len(figures)} figures in {len(results.sections)} of {len(SECTIONS)} sections, measured in {took_min:.0f} "
        f"minutes; {fixed} of them depend on the code alone. Of {bounded} bounds, {len(verdict.kept)} are kept and "
        f"{len(verdict.known) + len(verdict.missed)} missed. {len(verdict.unjudged)} figures were measured beside "
        "other work and are to be measured again.\n\n" + "".join(f"Measured on: {machine}.\n" for machine in machines)
    )


def misses(results: Results, known: Known) -> str:
    """Each missed bound with the reason."""
    figures = results.named()
    verdict = judge(figures, known.misses, results.busy)
    missed = [named for named in figures if named in {*verdict.known, *verdict.missed}]
    if not missed:
        return "No bound is known to be missed.\n"
    rows = [
        (
            SECTIONS[named[0]].title,
            named[1],
            *_value_and_bound(figures[named]),
            known.misses.get(named, "not known yet"),
        )
        for named in missed
    ]
    return _table(("section", "figure", "measured", "bound", "why"), rows)


def pages() -> list[Path]:
    """The pages with blocks."""
    return sorted(path for path in PAGES.rglob("*.md") if MARKER.search(path.read_text(encoding="utf-8")))


def _value_and_bound(figure: Figure) -> tuple[str, str]:
    return figure.value_text(), figure.bound_text()


def _kept_words(figure: Figure, measured: Conditions) -> str:
    if figure.kept is False and figure.kind is FigureKind.TIMING and measured.is_busy:
        return "busy"
    return KEPT_WORDS[figure.kept]


def _when(measured: Conditions) -> str:
    day = measured.date.partition("T")[0]
    before, after = measured.load
    return (
        f"Measured {day} at revision {measured.revision}, load {before:g} to {after:g}, other work took "
        f"{measured.others:g} cores"
    )


def _table(headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [headings, tuple("---" for _ in headings), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |\n" for line in lines)


def main() -> int:
    """Write the pages; 0 on success."""
    try:
        results, known = Results.read(), read_known()
        for path in pages():
            text = path.read_text(encoding="utf-8")
            new = filled(text, results, known)
            path.write_text(new, encoding="utf-8")
            sys.stdout.write(f"{path.relative_to(ROOT)}: {'as it was' if new == text else 'written'}\n")
    except (PageError, ResultsError) as error:
        sys.stderr.write(f"make figures: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
