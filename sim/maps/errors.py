"""What can go wrong with a floor plan.

ValueError
└── MapError            a map or drawing cannot be used; carries `.path` and `.key`
    └── PlacementError  a floor plan has no room for what was asked; carries `.asked` and `.found` too
"""

from pathlib import Path


class MapError(ValueError):
    """A map, a drawing or a floor plan that cannot be used, told in one sentence.

    `path` is the file at fault and `key` the key in it; each is None where there is none.
    """

    def __init__(self, message: str, *, path: Path | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.key = key


class PlacementError(MapError):
    """A floor plan has no room: `asked` places were wanted, `found` were found."""

    def __init__(self, message: str, *, asked: int, found: int) -> None:
        super().__init__(message)
        self.asked = asked
        self.found = found
