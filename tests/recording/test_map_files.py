"""`robrain export --map`: the map of a recording for ROS's map_server."""

import numpy as np
import pytest
import yaml

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.deploy.recordings.recording_commands import export_map
from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry
from robrain.recording.errors import RecordingError
from robrain.recording.export.map_server_files import write_grid
from robrain.recording.replay.player import Player
from robrain.sim.maps.floor_plan import load_map


def write_map(recording, path, at_s=None):
    return export_map(recording, path, at_s, lambda _share: None)


def test_the_files_hold_the_map_as_the_team_knew_it_and_can_be_driven_in(run, tmp_path):
    files = write_map(run, tmp_path / "floor.yaml")
    assert [file.name for file in files] == ["floor.yaml", "floor.pgm"]
    player = Player(run)
    grid = player.map_at(player.duration_s)
    player.close()
    plan = load_map(files[0])
    assert (plan.resolution_m, plan.origin_x_m, plan.origin_y_m) == (
        grid.geometry.resolution_m,
        grid.geometry.origin_x_m,
        grid.geometry.origin_y_m,
    )
    assert np.array_equal(plan.occupied & grid.known(), grid.classes() == OCCUPIED)


@pytest.mark.parametrize(
    "name", ["run #3", "[a]", "%x", "&y", "*z", "a: b", "- c", "'d", 'e"', "null", "ü🚌", " f ", "\u2028"]
)
def test_the_map_can_be_read_whatever_its_name(tmp_path, name):
    grid = OccupancyGrid(GridGeometry(resolution_m=0.05, origin_x_m=1e-7, origin_y_m=-1e16, width=4, height=3))
    files = write_grid(grid, tmp_path / f"{name}.yaml")
    for reader in (yaml.SafeLoader, yaml.CSafeLoader):
        found = yaml.load(files[0].read_text(encoding="utf-8"), reader)
        assert (found["image"], found["origin"]) == (files[1].name, [1e-7, -1e16, 0.0])


def test_an_earlier_map_knows_less(run, tmp_path):
    known = []
    for at_s in (2.0, None):
        write_map(run, tmp_path / f"{at_s}.yaml", at_s)
        known.append(np.count_nonzero(np.frombuffer((tmp_path / f"{at_s}.pgm").read_bytes(), np.uint8) == 254))
    assert 0 < known[0] < known[1]


def test_nothing_is_overwritten_and_nothing_half_written_left(run, tmp_path):
    (tmp_path / "floor.pgm").write_bytes(b"mine")
    with pytest.raises(RecordingError, match=r"floor\.pgm exists already"):
        write_map(run, tmp_path / "floor.yaml")
    assert (tmp_path / "floor.pgm").read_bytes() == b"mine"
    with pytest.raises(RecordingError, match="cannot write"):
        write_map(run, tmp_path / "no_folder" / "floor.yaml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["floor.pgm"]


@pytest.mark.parametrize("at_s", [-1.0, 99.0, float("nan")])
def test_a_time_that_the_recording_does_not_have_is_refused(run, tmp_path, at_s):
    with pytest.raises(RecordingError, match=r"--at .*: expected 0 to"):
        write_map(run, tmp_path / "floor.yaml", at_s)
