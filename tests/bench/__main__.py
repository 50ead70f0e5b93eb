"""`make bench`: measure, write docs/figures/bench.json, and fail on any missed bound that is not a known miss.

`make bench ARGS="motion tasks"` measures only these sections; the others keep their figures in the file.
"""

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console

from robrain.lab.bench.figure import WIDTH, Figure, show_figures
from tests.bench.judging import judge, read_known, verdict_lines
from tests.bench.results import RESULTS, Results, ResultsError, SectionResult
from tests.bench.section_process import SectionFailedError, measure_apart
from tests.bench.sections import SECTIONS

MISSED, UNUSABLE, INTERRUPTED = 1, 2, 130


def main() -> int:
    """Measure; 0 if all bounds are kept or known misses, 1 if not or a section failed, 2 for bad arguments."""
    options = _options()
    if options.list:
        _say(*(f"{name:<18}{section.title}" for name, section in SECTIONS.items()))
        return 0
    names = list(dict.fromkeys(options.sections)) or list(SECTIONS)
    try:
        known, results = read_known().misses, Results.read(options.out)
    except ResultsError as error:
        return _complain(str(error))
    if unknown := [name for name in names if name not in SECTIONS]:
        return _complain(f"expected sections of {', '.join(SECTIONS)}, got {', '.join(unknown)}")
    began_s, failed = time.monotonic(), []
    for number, name in enumerate(names, 1):
        _say(f"\n{name} ({number} of {len(names)})")
        try:
            result = measure_apart(name, _progress)
        except SectionFailedError as error:
            failed.append(name)
            _say(f"NOT MEASURED: {error}")
            continue
        _show(name, result)
        results = Results.read(options.out).with_section(name, result, list(SECTIONS))
        results.write(options.out)
    figures = {
        named: figure for named, figure in results.named().items() if named[0] in names and named[0] not in failed
    }
    verdict = judge(figures, known, results.busy)
    _say("", *verdict_lines(verdict, figures, known))
    if failed:
        _say(f"NOT MEASURED: {', '.join(failed)}")
    _say(f"{len(names)} sections in {(time.monotonic() - began_s) / 60:.1f} min; written to {options.out}")
    if options.out == RESULTS:
        _say("`make figures` brings the tables of the pages up to date")
    return 0 if verdict.is_good and not failed else MISSED


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="make bench", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("sections", nargs="*", help="names of sections; all if there are none")
    parser.add_argument("--list", action="store_true", help="print the names of the sections")
    parser.add_argument("--out", type=Path, default=RESULTS, help="file of results to bring up to date")
    return parser.parse_args()


def _progress(figure: Figure) -> None:
    mark = {True: "kept", False: "MISSED", None: ""}[figure.kept]
    _say(f"  {mark:<7}{figure.name}: {figure.value_text()}")


def _show(name: str, result: SectionResult) -> None:
    before, after = result.measured.load
    show_figures(SECTIONS[name].title, result.figures, Console(width=WIDTH))
    _say(f"{result.measured.took_s:.1f} s, load {before:g} before and {after:g} after")
    if result.measured.is_busy:
        _say(f"other work took {result.measured.others:g} cores: timings that miss their bound are not judged")


def _say(*lines: str) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    sys.stdout.flush()


def _complain(text: str) -> int:
    sys.stderr.write(f"make bench: {text}\n")
    return UNUSABLE


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)  # earlier sections are in the file
