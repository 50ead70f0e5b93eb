"""Write all generated pages."""

import sys

from tests.reference_pages.pages import DOCS, PAGES


def main() -> None:
    """Write each page, and say which have changed."""
    for name, page in PAGES.items():
        path = DOCS / name
        old = path.read_text(encoding="utf-8") if path.exists() else ""
        new = page()
        path.write_text(new, encoding="utf-8")
        sys.stdout.write(f"docs/{name}: {'as it was' if new == old else 'written'}\n")


if __name__ == "__main__":
    main()
