"""The pages' tables agree with docs/figures/bench.json, so that no two pages print different figures."""

import re
from pathlib import Path

import pytest

from robrain.lab.bench.figure import at_most, timing
from tests.bench.judging import Known, judge, read_known, untrue
from tests.bench.results import ROOT, Conditions, Machine, Results, SectionResult
from tests.bench.sections import SECTIONS
from tests.bench.tables import blocks, filled, pages

MACHINE = Machine(cpu="any", cores=2, memory_gb=1.0, system="any", python="3")
CONDITIONS = Conditions(
    date="2026-01-02T03:04Z", took_s=60.0, revision="abc", machine=MACHINE, load=(0.25, 0.5), others=0.1
)
FIGURES = [timing("a step", 3.0, "ms", at_most(2), "once | twice"), timing("way", 1234.5, "m")]
RESULTS = Results(sections={"tasks": SectionResult(measured=CONDITIONS, figures=FIGURES)})
NOTHING = Known({}, {})
MEASURED = re.compile(r"\d ?(ms|µs|s|min|m|mm|cm|%|×|Hz|J|MB|kB|Wh|cores?)(?![\w-])")
"""A number with a unit."""


@pytest.mark.parametrize("path", pages(), ids=lambda path: path.stem)
def test_tables_of_the_page_are_those_of_the_results(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text == filled(text, Results.read(), read_known()), "make figures"


def test_each_section_stands_in_one_page() -> None:
    named = [name for path in pages() for name in blocks(path.read_text(encoding="utf-8"))]
    assert sorted(named) == sorted([*SECTIONS, "summary", "misses"])


def test_each_missed_bound_and_each_section_without_figures_is_known_and_the_other_way_round() -> None:
    results, known = Results.read(), read_known()
    assert judge(results.named(), known.misses, results.busy).missed == []
    assert untrue(results, known, SECTIONS) == []


def test_status_prints_no_figure_by_hand() -> None:
    text = (ROOT / "docs" / "STATUS.md").read_text(encoding="utf-8")
    for body in blocks(text).values():
        text = text.replace(body, "")
    assert [line for line in text.splitlines() if MEASURED.search(line)] == []


def test_block_is_written_anew_and_all_else_is_left() -> None:
    page = "# Page\n\n<!-- figures: tasks -->\nold\n<!-- /figures -->\n\nend\n"
    new = filled(page, RESULTS, NOTHING)
    assert new.startswith("# Page\n\n<!-- figures: tasks -->\n")
    assert new.endswith("<!-- /figures -->\n\nend\n")
    assert "old" not in new
    assert "| a step | 3 ms | ≤ 2 ms | **no** | once / twice |\n| way | 1,234 m | – |  |  |\n" in new
    assert "Measured 2026-01-02 at revision abc, load 0.25 to 0.5, other work took 0.1 cores." in new
    assert filled(new, RESULTS, NOTHING) == new


def test_missed_bounds_are_listed_with_why() -> None:
    page = "<!-- figures: misses -->\n<!-- /figures -->\n<!-- figures: summary -->\n<!-- /figures -->\n"
    new = filled(page, RESULTS, Known({("tasks", "a step"): "half a core short"}, {}))
    assert "| Tasks | a step | 3 ms | ≤ 2 ms | half a core short |" in new
    assert f"2 figures in 1 of {len(SECTIONS)} sections" in new
    assert "Of 1 bounds, 0 are kept and 1 missed. 0 figures were measured beside other work" in new
    assert "| not known yet |" in filled(page, RESULTS, NOTHING)
