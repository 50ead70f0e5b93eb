import subprocess
import sys

import pytest

from robrain.agent.authoring.plugin_check import check_plugins
from robrain.agent.authoring.skeleton import write_skeleton
from robrain.agent.authoring.testing import PluginBench
from robrain.agent.errors import PluginError
from robrain.agent.manifest import read_manifest
from robrain.protocol.errors import ErrorCode
from tests.agent.conftest import refused

LEVELS = ("device", "unit", "skill", "behavior")


# -- what is written --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plain", [True, False])
@pytest.mark.parametrize("level", [*LEVELS[:3], pytest.param("behavior", marks=pytest.mark.slow)])
def test_a_skeleton_runs_as_it_was_asked_for(tmp_path, level, plain):
    source, manifest, test = write_skeleton("lamp", level, tmp_path, active=not plain, hidden=not plain)
    assert [path.name for path in (source, manifest, test)] == ["lamp.py", "lamp.toml", "test_lamp.py"]
    assert read_manifest(manifest).tag.visibility == (["command"] if plain else [])
    assert check_plugins(tmp_path) == []
    with PluginBench(tmp_path / "lamp") as bench:
        info = bench.info("lamp")
        assert (info.level, info.state, info.why) == (level, "active", "")
        if level == "behavior":
            assert info.task_kind.kind == "lamp"
            return
        assert info.period_s == (None if plain else 1.0)
        if not plain:
            assert refused(bench.call, "lamp", info.functions[0].name).code is ErrorCode.FORBIDDEN


@pytest.mark.slow
def test_the_tests_of_skeletons_pass_and_are_as_the_linter_wants_them(tmp_path):
    for level in LEVELS:
        write_skeleton(f"my_{level}", level, tmp_path, active=True)
        write_skeleton(f"hidden_{level}", level, tmp_path, hidden=True)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert "11 passed" in done.stdout
    for words in (["check", "--select", "E,F,W,I,N,UP,B,D100,D101"], ["format", "--check"]):
        ruff = [sys.executable, "-m", "ruff", *words, "--no-cache", "--isolated", "--line-length", "120", "."]
        done = subprocess.run(ruff, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("name", "class_name"),
    [
        ("line_follower", "LineFollower"),
        ("unit", "UnitPlugin"),  # the base's own name
        ("task", "TaskPlugin"),  # what the module imports
        ("none", "NonePlugin"),  # a word of Python's own, once it is written as a class
        ("_1", "Plugin1"),
    ],
)
def test_a_class_is_named_after_its_plugin(tmp_path, name, class_name):
    _, manifest, _ = write_skeleton(name, "unit", tmp_path)
    assert read_manifest(manifest).class_path == f"{name}:{class_name}"
    assert check_plugins(tmp_path) == []


# -- what is refused --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "level", "why"),
    [
        ("", "unit", "it is empty"),
        ("2lamps", "unit", "expected a Python name"),
        ("my-lamp", "unit", "expected a Python name"),  # a key, but no Python
        ("class", "unit", "it is a word of Python's own"),
        ("_", "unit", "expected a letter"),
        ("lämp", "unit", "may not stand in a name"),  # Python, but no key
        ("x" * 64, "unit", "longer than 63"),
        ("command", "unit", "stands for the outside"),
        ("lamp", "gadget", "unknown level 'gadget': expected one of device, unit, skill, behavior"),
    ],
)
def test_bad_names_and_levels_are_refused_in_words_and_nothing_is_written(tmp_path, name, level, why):
    with pytest.raises(PluginError) as wrong:
        write_skeleton(name, level, tmp_path)
    assert why in str(wrong.value)
    assert wrong.value.plugin == name
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_left_as_it_is(tmp_path):
    (tmp_path / "lamp").write_text("mine")
    with pytest.raises(PluginError, match="is there already"):
        write_skeleton("lamp", "unit", tmp_path)
    assert list(tmp_path.rglob("*")) == [tmp_path / "lamp"]


# -- the bench of the skeletons' tests --------------------------------------------------------------------------

COUNTER = """
import msgspec
from robrain.agent.plugin import Device, external


class Counter(Device):
    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        start: int = 0

    period_s = 0.5

    def init(self):
        self.count = self.parameters.start
        self.dice = self.env.rng.integers(0, 1000, 4).tolist()

    def step(self):
        self.count += 1

    @external
    def add(self, number: int, times: int = 1) -> int:
        return self.count + number * times
"""


@pytest.fixture
def counter(tmp_path):
    folder = tmp_path / "counter"
    folder.mkdir()
    (folder / "counter.py").write_text(COUNTER)
    (folder / "counter.toml").write_text('[plugin]\nclass = "counter:Counter"\n')
    return folder


def test_the_bench_takes_parameters_and_a_seed_and_time_passes_only_when_it_is_run(counter):
    with PluginBench(counter, parameters={"counter": {"start": 40}}, seed=1) as bench:
        assert bench.call("counter", "add", 1, 2) == 42
        bench.run(3.0)
        assert bench.plugin("counter").env.clock.now_ns() == 3_000_000_000
        assert bench.call("counter", "add", 0) in (46, 47)  # a first step at the start, or not
        dice = bench.plugin("counter").dice
    for seed, is_same in ((1, True), (2, False)):
        with PluginBench(counter, seed=seed) as bench:
            assert (bench.plugin("counter").dice == dice) is is_same
