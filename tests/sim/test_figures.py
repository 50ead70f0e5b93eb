"""Deterministic figures, compared with their bounds and with the pages.

After a change that affects them, run `make bench ARGS=exploration`, then `make figures`.
"""

import pytest

from robrain.lab.bench.figure import Figure, FigureKind
from tests.bench import exploration
from tests.bench.results import Results

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
PRINTED = Results.read().named()


def missed(figures: list[Figure]) -> list[str]:
    """Messages for deterministic figures that miss their bound."""
    fixed = [figure for figure in figures if figure.kind is FigureKind.DETERMINISTIC]
    assert fixed
    return [
        f"{figure.name}: {figure.value_text()}, bound {figure.bound_text()}" for figure in fixed if figure.kept is False
    ]


def misprinted(section: str, figures: list[Figure]) -> list[str]:
    """Messages for figures that differ from the pages."""
    fixed = [figure for figure in figures if figure.kind is FigureKind.DETERMINISTIC]
    printed = {figure.name: PRINTED.get((section, figure.name)) for figure in fixed}
    return [
        f"{figure.name}: measured {figure.value_text()}, printed {old.value_text() if old else 'nothing'}"
        for figure in fixed
        if (old := printed[figure.name]) is None or old.value_text() != figure.value_text()
    ]


def test_map_is_explored_in_time_without_collisions_as_the_pages_print() -> None:
    """`make bench` compares the real maps too."""
    figures = exploration.run_figures(exploration.OWN, exploration.OWN.run())
    assert missed(figures) == []
    assert misprinted("exploration", figures) == []
