"""The real maps, which lie beside the project and do not come with it.

A test that needs them is marked `needs_real_maps`; where they are not, the end of the test run says how many tests were
left out for that reason. What such tests hold is held on `examples/maps` in any clone.
"""

from pathlib import Path

import pytest

REAL_MAPS = Path(__file__).parents[2] / "shared" / "maps"
WHY_NOT = "the real maps do not come with the project: ../shared/maps"

needs_real_maps = pytest.mark.skipif(not REAL_MAPS.is_dir(), reason=WHY_NOT)


def require_real_maps() -> None:
    """FileNotFoundError where there are none."""
    if not REAL_MAPS.is_dir():
        raise FileNotFoundError(WHY_NOT)
