"""The documentation site builds without a broken link, and needs nothing from elsewhere."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from robrain.protocol.toml_text import read_toml
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


@pytest.mark.system
def test_broken_links_end_the_build_and_are_named(tmp_path: Path) -> None:
    text = "# Page\n\n[home](index.md#page) [one](gone.md) [two](#lost) [three](/left.html)\n"
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text(text, encoding="utf-8")
    config = tmp_path / "mkdocs.yml"
    own = {"docs_dir": docs, "hooks": "[]", "plugins": "[]", "extra_css": "[]", "nav": "[index.md]"}
    lines = [f"INHERIT: {ROOT / 'mkdocs.yml'}", *(f"{key}: {value}" for key, value in own.items())]
    config.write_text("\n".join(lines), encoding="utf-8")
    built = build(config, tmp_path / "site")
    assert built.returncode == 1
    assert all(target in built.stderr for target in ("gone.md", "lost", "left.html"))
    assert "index.md#page" not in built.stderr


def test_everything_that_the_site_needs_is_pinned() -> None:
    extra = read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"]["docs"]
    pinned = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    names = [re.match(r"[\w-]+", requirement)[0] for requirement in extra]
    assert [name for name in names if not re.search(rf"^{name}==", pinned, re.MULTILINE)] == []
