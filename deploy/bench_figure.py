"""Figures that benchmarks measure, and how they are shown: a table for people, one JSON object for programs."""

import sys
from collections.abc import Iterable

import msgspec
from rich.console import Console
from rich.table import Table

WIDTH = 110
HEADINGS = ("what", "measured", "beside", "bound", "kept")


class Figure(msgspec.Struct, frozen=True):
    """One figure, in words and, where it is a single number, as that."""

    what: str
    value: str
    beside: str
    """What it is compared with."""
    bound: str
    is_kept: bool
    number: float | None = None
    """The value in `unit`."""
    unit: str = ""


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """What one benchmark says with `--json`."""

    bench: str
    figures: list[Figure]
    all_kept: bool


def measured(bench: str, figures: Iterable[Figure]) -> Measured:
    """The figures of one benchmark, put together."""
    found = list(figures)
    return Measured(bench=bench, figures=found, all_kept=all(figure.is_kept for figure in found))


def show_figures(title: str, figures: Iterable[Figure], console: Console) -> None:
    """A line for each figure, with what it is compared with and the bound that it is to keep."""
    table = Table(title=title, title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading)
    for figure in figures:
        table.add_row(figure.what, figure.value, figure.beside, figure.bound, "yes" if figure.is_kept else "no")
    console.print(table)


def report(bench: str, figures: Iterable[Figure], *, as_json: bool) -> None:
    """Print what a benchmark measures, to stdout: a table, or one JSON object."""
    console = Console(stderr=True)
    found = []
    with console.status(f"{bench}: measuring", spinner="line"):
        for figure in figures:
            found.append(figure)
            if not as_json and console.is_terminal:
                console.print(f"{figure.what}: {figure.value}", highlight=False)
    if as_json:
        sys.stdout.write(msgspec.json.encode(measured(bench, found)).decode() + "\n")
    else:
        show_figures(f"{bench}, each figure beside the bound that it is to keep", found, Console(width=WIDTH))
