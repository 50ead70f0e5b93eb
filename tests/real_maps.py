"""The real maps, which are expected beside the project and are not part of it.

Tests that need them are marked `needs_real_maps`; without the maps, the end of the test run says how many tests were
skipped. In any clone, other tests check the same on `examples/maps`.
"""

from pathlib import Path

import pytest

REAL_MAPS = Path(__file__).parents[2] / "shared" / "maps"
WHY_NOT = "the real maps do not come with the project: ../shared/maps"

needs_real_maps = pytest.mark.skipif(not REAL_MAPS.is_dir(), reason=WHY_NOT)


def require_real_maps() -> None:
    """Raise FileNotFoundError if the maps are missing."""
    if not REAL_MAPS.is_dir():
        raise FileNotFoundError(WHY_NOT)
