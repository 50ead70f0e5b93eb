"""Benchmark figures: one number each, with its unit and bound.

Every benchmark reports through `deterministic` and `timing`, as a table for people or JSON for programs; `make bench`
stores the same figures in docs/figures/bench.json.
"""

import math
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from rich.console import Console
from rich.table import Table

Run = TypeVar("Run")
WIDTH = 110
HEADINGS = ("figure", "measured", "bound", "kept", "beside")
KEPT_WORDS = {True: "yes", False: "no", None: "–"}
NO_VALUE = "none"


class FigureKind(StrEnum):
    """Dependence of a figure."""

    DETERMINISTIC = "deterministic"
    """Only the code: equal on every machine."""
    TIMING = "timing"
    """Also the machine and its load."""


class Bound(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Allowed values of a figure, in its unit; all limits given must hold."""

    at_most: float | None = None
    at_least: float | None = None
    below: float | None = None
    above: float | None = None

    def __post_init__(self) -> None:
        limits = [limit for limit in msgspec.structs.astuple(self) if limit is not None]
        if not limits or not all(map(math.isfinite, limits)):
            raise ValueError(f"expected a bound with finite limits, got {self!r}")

    def is_kept_by(self, value: float | None) -> bool:
        """Whether a value is within the bound; None is within none."""
        if value is None:
            return False
        return (
            (self.at_most is None or value <= self.at_most)
            and (self.at_least is None or value >= self.at_least)
            and (self.below is None or value < self.below)
            and (self.above is None or value > self.above)
        )

    def words(self, unit: str = "") -> str:
        """The bound as shown in tables: `≤ 50 ms`."""
        named = (("≥", self.at_least), (">", self.above), ("≤", self.at_most), ("<", self.below))
        return " and ".join(f"{sign} {with_unit(limit, unit)}" for sign, limit in named if limit is not None)


class Figure(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One measured number.

    A value that is not finite becomes None: there is no measurement. `kept` is computed from value and bound, whatever
    argument was passed; None without a bound.
    """

    name: str
    """Unique within its benchmark, and equal in every run."""
    value: float | None
    unit: str = ""
    bound: Bound | None = None
    kind: FigureKind
    beside: str = ""
    """Text shown with the number: a comparison in the same run, a spread, a size."""
    kept: bool | None = None

    def __post_init__(self) -> None:
        if self.value is not None and not math.isfinite(self.value):
            self.value = None
        self.kept = None if self.bound is None else self.bound.is_kept_by(self.value)

    def value_text(self) -> str:
        """The value with its unit as shown in tables."""
        return NO_VALUE if self.value is None else with_unit(self.value, self.unit)

    def bound_text(self) -> str:
        """The bound with its unit as shown in tables."""
        return "–" if self.bound is None else self.bound.words(self.unit)


def deterministic(name: str, value: float, unit: str = "", bound: Bound | None = None, beside: str = "") -> Figure:
    """A figure that is equal on every machine."""
    return Figure(name=name, value=float(value), unit=unit, bound=bound, kind=FigureKind.DETERMINISTIC, beside=beside)


def timing(name: str, value: float, unit: str = "", bound: Bound | None = None, beside: str = "") -> Figure:
    """A figure that depends on the machine."""
    return Figure(name=name, value=float(value), unit=unit, bound=bound, kind=FigureKind.TIMING, beside=beside)


def at_most(limit: float) -> Bound:
    """Bound: values up to and including this one."""
    return Bound(at_most=limit)


def at_least(limit: float) -> Bound:
    """Bound: values from this one upwards."""
    return Bound(at_least=limit)


def below(limit: float) -> Bound:
    """Bound: values less than this one."""
    return Bound(below=limit)


def above(limit: float) -> Bound:
    """Bound: values greater than this one."""
    return Bound(above=limit)


def between(least: float, most: float) -> Bound:
    """Bound: values from the first to the second, both included."""
    return Bound(at_least=least, at_most=most)


def with_unit(value: float, unit: str) -> str:
    """A number to three significant digits but not more than four decimals, whole numbers in full, and its unit.

    >>> with_unit(0.012345, "s"), with_unit(16504.1, ""), with_unit(99.96, "%"), with_unit(-0.00001, "MB")
    ('0.0123 s', '16,504', '100 %', '0 MB')
    """
    rounded = round(value, 4) + 0.0  # no -0
    number = f"{rounded:,.0f}" if abs(rounded) >= 99.95 or rounded == round(rounded) else f"{rounded:.3g}"
    if "e" in number:
        number = f"{rounded:.4f}"
    return f"{number} {unit}" if unit else number


def are_kept(figures: Iterable[Figure]) -> bool:
    """Whether no figure is beyond its bound."""
    return all(figure.kept is not False for figure in figures)


def show_figures(title: str, figures: Iterable[Figure], console: Console) -> None:
    """Print a line for each figure, with its bound and its `beside` text."""
    table = Table(*HEADINGS, title=title, title_justify="left")
    for figure in figures:
        cells = (figure.name, figure.value_text(), figure.bound_text(), KEPT_WORDS[figure.kept], figure.beside)
        table.add_row(*cells)
    console.print(table)


class BenchReport(msgspec.Struct, Generic[Run], frozen=True, kw_only=True):
    """Contents of the file of `--json`."""

    bench: str
    runs: list[Run]
    figures: list[Figure]
    all_kept: bool


def write_json(path: Path | None, bench: str, runs: list[Run], figures: Iterable[Figure]) -> None:
    """Write the output of `--json FILE`, if it is requested."""
    if path is not None:
        found = list(figures)
        write_report(path, BenchReport(bench=bench, runs=runs, figures=found, all_kept=are_kept(found)))


def write_report(path: Path, report: msgspec.Struct) -> None:
    """Write a report as JSON that people can read."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
