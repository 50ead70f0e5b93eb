"""Hooks of the documentation site: pages that live outside docs/, and links that leave docs/.

Pages are written for readers of the repository, whose links lead to files. On the site, a link to another page leads to
that page; a link to any other file of the repository becomes the file's path.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
GUESTS = {
    "ARCHITECTURE.md": "explanation/architecture.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "examples/README.md": "tutorial/examples.md",
}
"""Pages outside docs/ by their path, and where they stand on the site."""
FOLDERS = {"docs/decisions": "explanation/decisions.md"}
LINK = re.compile(r"(?<!!)\[(?P<text>[^\]\n]*)\]\((?P<target>[^)\s]+)\)")
FILE_NAME = re.compile(r"[\w/-]+(\.md)?")
CELL = re.compile(r"<td[^>]*>.*?</td>", re.DOTALL)
LONG_CODE = re.compile(r"(?<=<code>)[^<]{24,}(?=</code>)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that live outside docs/."""
    for source, uri in GUESTS.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with links that work on the site."""
    homes = {uri: source for source, uri in GUESTS.items()}
    uri = page.file.src_uri
    folder = posixpath.dirname(homes.get(uri, f"docs/{uri}"))
    return LINK.sub(lambda link: site_link(link, folder, posixpath.dirname(uri)), markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page, in whose tables long names may break at their joints."""
    return CELL.sub(lambda cell: LONG_CODE.sub(lambda code: re.sub(r"::|[/_,]", r"\g<0><wbr>", code[0]), cell[0]), html)


def site_link(link: re.Match[str], folder: str, site_folder: str) -> str:
    """A link as it is on the site.

    Args:
        link: a match of `LINK`.
        folder: of the page in the repository.
        site_folder: of the page on the site.

    """
    target, _, anchor = link["target"].partition("#")
    path = posixpath.normpath(posixpath.join(folder, target))
    if not target or "://" in target or not (ROOT / path).exists():
        return link[0]  # a missing file is mkdocs' to report
    uri = GUESTS.get(path) or FOLDERS.get(path)
    if uri is None and path.startswith("docs/"):
        uri = path.removeprefix("docs/")
    if uri is not None:
        to = posixpath.relpath(uri, site_folder or ".")
        is_file_name = FILE_NAME.fullmatch(link["text"]) and path.endswith(link["text"])
        text = title_of(path, uri) if is_file_name else link["text"]
        return f"[{text}]({to}{'#' + anchor if anchor else ''})"
    text = link["text"].strip("`")
    return f"`{path}`" if text in path else f"{text} (`{path}`)"


def title_of(path: str, uri: str) -> str:
    """The heading of a page."""
    file = ROOT / path if path in GUESTS else ROOT / "docs" / uri
    return file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
