import json

import pytest
from typer.testing import CliRunner

from robrain.cli import all_commands
from robrain.lab.soak.fault_script import script_json
from robrain.lab.soak.script_drawing import draw_script
from robrain.lab.soak.soaking import SoakOptions, soak
from tests.lab.soak.planted import planted

SEED = 5
"""Finds `strays_stay`."""


def robrain(*words):
    return CliRunner().invoke(all_commands(), [str(word) for word in words])


@pytest.mark.slow
def test_a_soak_of_the_product_breaks_nothing_and_counts_what_it_ran(tmp_path):
    result = soak(SoakOptions(seeds=range(2, 3), jobs=1, output=tmp_path / "out"))
    assert (result.runs, result.failures, result.errors) == (1, [], [])
    assert result.tasks_done > 5
    assert sum(result.faults.values()) == len(draw_script(2).faults)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_script_runs_again_from_its_file_and_exits_with_1_if_it_fails(tmp_path):
    file = tmp_path / "s.json"
    file.write_bytes(script_json(draw_script(SEED)))
    ended = robrain("soak", "--repeat", file)
    assert ended.exit_code == 0
    assert "no invariant broken" in ended.output
    with planted("strays_stay"):
        ended = robrain("soak", "--repeat", file, "--json")
    assert ended.exit_code == 1
    assert json.loads(ended.output)["broken"][0]["invariant"] == "done_twice"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--runs", 0), "--runs 0: expected at least 1"),
        (("--full", "--repeat", "x.json"), "--full: expected no --repeat"),
        (("--minutes", -1), "--minutes"),
        (("--repeat", "nowhere.json"), "nowhere.json: cannot be read"),
    ],
)
def test_bad_options_are_refused(words, told):
    ended = robrain("soak", *words)
    assert ended.exit_code != 0
    assert told in f"{ended.output} {ended.exception}"
