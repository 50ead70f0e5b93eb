import pytest

from robrain.algorithms.allocation.warm_up import warm_up


@pytest.fixture(scope="session", autouse=True)
def _compiled():
    """Kernels are compiled before a test is timed, and not under hypothesis' tracer."""
    warm_up()
