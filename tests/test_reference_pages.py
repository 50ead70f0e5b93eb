"""The generated pages of the documentation are what the code says."""

import pytest

from tests.reference_pages.pages import DOCS, PAGES


@pytest.mark.parametrize("name", PAGES)
def test_page_is_what_the_code_says(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name](), "python -m tests.reference_pages"
