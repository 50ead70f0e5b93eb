"""Test benches for plugins.

`PluginBench` runs plugins on a real robot host in lockstep, with a clock that the test moves. `ForeignBench` runs a
plugin in its own process, written in any language, on a live hub.

@pytest.fixture
def bench():
    with PluginBench(Path(__file__).parent) as bench:
        yield bench

def test_lamp_is_bright_after_two_seconds(bench):
    bench.run(2.0)
    assert bench.call("lamp", "brightness") == 3
"""

from robrain.agent.authoring.foreign_bench import ForeignBench
from robrain.agent.authoring.testing import PluginBench

__all__ = ["ForeignBench", "PluginBench"]
