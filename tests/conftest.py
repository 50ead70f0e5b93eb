"""For all tests: no timing fails one, so hypothesis sets no deadline; in CI it draws the same examples each time."""

import os

from hypothesis import settings

settings.register_profile("robrain", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("robrain")
