from robrain.agent.authoring.testing import PluginBench


def test_the_counter_counts_the_seconds_since_the_start():
    with PluginBench(load=["counter"]) as bench:
        assert bench.call("counter", "seconds") == 0
        bench.run(3.5)
        assert bench.call("counter", "seconds") == 3
