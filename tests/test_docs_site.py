"""The documentation site builds without a broken link, and needs nothing from elsewhere."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reference_pages.pages import DOCS

ROOT = DOCS.parent
LOADED = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=["']?(?:https?:)?//[^"'\s>]*""")
"""A tag that makes a browser fetch something from another host."""


def build(config: Path, site: Path) -> "subprocess.CompletedProcess[str]":
    """Build a site as `make docs` does."""
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--config-file", str(config), "--site-dir", str(site)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=500,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of this project; a broken link, anchor or reference ends the build."""
    folder = tmp_path_factory.mktemp("site")
    built = build(ROOT / "mkdocs.yml", folder)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.system
def test_every_page_is_built_with_those_outside_docs(site: Path) -> None:
    pages = {str(page.relative_to(site).with_suffix(".md")) for page in site.rglob("*.html")}
    assert {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} <= pages
    assert {"explanation/architecture.md", "project/contributing.md", "tutorial/examples.md"} <= pages


@pytest.mark.system
def test_pages_fetch_nothing_from_elsewhere(site: Path) -> None:
    fetched = {found for page in site.rglob("*.html") for found in LOADED.findall(page.read_text(encoding="utf-8"))}
    assert fetched == set()


@pytest.mark.system
def test_links_that_leave_docs_lead_to_pages_or_become_paths(site: Path) -> None:
    page = (site / "how-to" / "plugins.html").read_text(encoding="utf-8")
    assert "<code>agent/action.py</code>" in page
    assert "../../agent" not in page
    assert '"docs/' not in (site / "explanation" / "architecture.html").read_text(encoding="utf-8")


@pytest.mark.system
def test_tutorial_shows_the_example_that_it_explains(site: Path) -> None:
    page = (site / "tutorial" / "your-own-task-script.html").read_text(encoding="utf-8")
    first = (ROOT / "examples" / "02_submit_tasks.py").read_text(encoding="utf-8").partition('"""')[2][:40]
    assert first in html.unescape(page)
    assert "8<--" not in html.unescape(page)
