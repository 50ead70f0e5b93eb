"""For tests of plugins: a real robot host in lockstep, with a clock that the test moves.

import pytest
from robrain.testing import PluginBench

@pytest.fixture
def bench():
    with PluginBench(Path(__file__).parent) as bench:
        yield bench

def test_lamp_is_bright(bench):
    bench.run(2.0)
    assert bench.call("lamp", "brightness") == 3
"""

from robrain.agent.testing import PluginBench

__all__ = ["PluginBench"]
