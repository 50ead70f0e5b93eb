from collections.abc import Iterator

import pytest

from tests.plugins.behavior.errands import Build, open_errands


@pytest.fixture
def errands() -> Iterator[Build]:
    yield from open_errands()
