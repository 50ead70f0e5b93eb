"""Where the product's code stands."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = tuple(sorted(path.name for path in (ROOT / "robrain").iterdir() if path.is_symlink()))
"""Top-level folders with code, each of which `robrain/` links to."""
