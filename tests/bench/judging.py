"""Which bounds are kept, which are missed, and which misses are known.

`docs/figures/known_misses.toml` lists accepted misses, each with the reason. Any other miss fails `make bench`, both of
deterministic figures and of timings. A timing that misses its bound while other processes use the cores is neither kept
nor missed: it has to be measured again, and `make bench` fails until then.
"""

import tomllib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec

from robrain.lab.bench.figure import Figure, FigureKind
from tests.bench.results import RESULTS, Results, ResultsError

KNOWN_MISSES = RESULTS.with_name("known_misses.toml")

Named = tuple[str, str]
"""Section and name of a figure."""
T = TypeVar("T", tuple[str], Named)


class KnownMiss(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A bound that is currently missed."""

    section: str
    figure: str
    why: str


class Unmeasured(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A section that is currently not measured."""

    section: str
    why: str


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    miss: list[KnownMiss] = []
    unmeasured: list[Unmeasured] = []


class Known(NamedTuple):
    """Known misses and unmeasured sections, each with the reason."""

    misses: dict[Named, str]
    unmeasured: dict[str, str]
    """By section."""


class Verdict(NamedTuple):
    """The result of comparing figures, bounds and known misses."""

    kept: list[Named]
    known: list[Named]
    """Missed and listed as a known miss."""
    missed: list[Named]
    """Missed and not listed."""
    unjudged: list[Named]
    """Timings that missed beside other work and are not listed."""
    kept_again: list[Named]
    """Listed as a known miss but kept."""

    @property
    def is_good(self) -> bool:
        """Whether every bound is kept or is a known miss."""
        return not self.missed and not self.unjudged


def read_known(path: Path = KNOWN_MISSES) -> Known:
    """Read the list (ResultsError if it cannot be read, lacks a reason, or has duplicates)."""
    try:
        found = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), _File)
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path.name}: expected a list of known misses, got: {error}") from error
    misses = _by_name(path, [((miss.section, miss.figure), miss.why) for miss in found.miss])
    unmeasured = _by_name(path, [((each.section,), each.why) for each in found.unmeasured])
    return Known(misses, {section: why for (section,), why in unmeasured.items()})


def _by_name(path: Path, listed: list[tuple[T, str]]) -> dict[T, str]:
    by_name: dict[T, str] = {}
    for name, why in listed:
        if not why.strip():
            raise ResultsError(f"{path.name}: {': '.join(name)}: expected why, got nothing")
        if name in by_name:
            raise ResultsError(f"{path.name}: {': '.join(name)}: expected once, got twice")
        by_name[name] = why
    return by_name


def judge(figures: dict[Named, Figure], known: dict[Named, str], busy: Collection[str] = ()) -> Verdict:
    """Compare all figures with their bounds; `busy` are sections that were measured beside other work."""
    verdict = Verdict([], [], [], [], [])
    for named, figure in figures.items():
        if figure.kept is None:
            continue
        if figure.kept:
            verdict.kept.append(named)
            if named in known:
                verdict.kept_again.append(named)
        elif named in known:
            verdict.known.append(named)
        else:
            is_unjudged = figure.kind is FigureKind.TIMING and named[0] in busy
            (verdict.unjudged if is_unjudged else verdict.missed).append(named)
    return verdict


def untrue(results: Results, known: Known, sections: Iterable[str]) -> list[str]:
    """Messages for entries of the list that contradict the results.

    A listed timing may be kept in one run, as it is listed for not being kept in every run.
    """
    figures = results.named()
    found = [
        f"{section}: it is {'' if section in results.sections else 'not '}measured"
        for section in sections
        if (section in results.sections) == (section in known.unmeasured)
    ]
    for section, name in known.misses:
        figure = figures.get((section, name))
        if figure is None:
            if section not in known.unmeasured:
                found.append(f"{section}: {name}: there is no such figure")
        elif figure.kept is None:
            found.append(f"{section}: {name}: it has no bound")
        elif figure.kept and figure.kind is FigureKind.DETERMINISTIC:
            found.append(f"{section}: {name}: its bound is kept")
    return found


def verdict_lines(verdict: Verdict, figures: dict[Named, Figure], known: dict[Named, str]) -> list[str]:
    """The verdict as text for a terminal."""
    unbounded = sum(figure.kept is None for figure in figures.values())
    counts = tuple(map(len, (verdict.kept, verdict.known, verdict.missed, verdict.unjudged)))
    lines = [
        "bounds: {} kept, {} known misses, {} missed, {} to be measured again; ".format(*counts)
        + f"{unbounded} figures without"
    ]
    lines += _listed("known misses", ((each, known[each]) for each in verdict.known), figures)
    lines += _listed(
        "known misses that are kept in this run", ((each, known[each]) for each in verdict.kept_again), figures
    )
    for kind in FigureKind:
        missed = [each for each in verdict.missed if figures[each].kind is kind]
        lines += _listed(f"MISSED, {kind}", ((each, "") for each in missed), figures)
    again = ((each, "") for each in verdict.unjudged)
    return lines + _listed("too slow, but other work took the cores: MEASURE AGAIN", again, figures)


def _listed(title: str, found: Iterable[tuple[Named, str]], figures: dict[Named, Figure]) -> list[str]:
    lines = []
    for (section, name), why in found:
        figure = figures[section, name]
        lines.append(f"  {section}: {name}: {figure.value_text()}, bound {figure.bound_text()}")
        if why:
            lines.append(f"    {why}")
    return [f"{title}:", *lines] if lines else []
