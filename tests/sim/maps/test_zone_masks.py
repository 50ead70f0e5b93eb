"""Masks of Nav2's costmap filters become zones that hold in the same cells."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from robrain.algorithms.mapping.zone_grid import cells_in
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.zone import ZoneKind
from robrain.recording.errors import MapError
from robrain.sim.maps.zone_masks import SpeedScale, zones_of_mask

KEEP_OUT = "mode: trinary\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
SPEED = "mode: scale\noccupied_thresh: 1.0\nfree_thresh: 0.0\n"


def write(folder: Path, pixels: np.ndarray, keys: str, resolution_m: float = 0.1) -> Path:
    """A mask whose lower left corner is at (-1, 2)."""
    Image.fromarray(pixels.astype(np.uint8)).save(folder / "mask.pgm")
    path = folder / "mask.yaml"
    path.write_text(f"image: mask.pgm\nresolution: {resolution_m}\norigin: [-1.0, 2.0, 0]\nnegate: 0\n{keys}")
    return path


def cells_of(zone, shape, resolution_m=0.1):
    """Cells of the image that a zone holds, row 0 at the top."""
    return np.flipud(cells_in(zone, GridGeometry(resolution_m, -1.0, 2.0, shape[1], shape[0])))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**63), st.integers(1, 9), st.integers(1, 9), st.floats(0.05, 0.95))
def test_a_keep_out_zone_holds_in_the_black_cells_of_its_mask(tmp_path_factory, seed, height, width, share):
    is_black = np.random.default_rng(seed).random((height, width)) < share
    path = write(tmp_path_factory.mktemp("mask"), np.where(is_black, 0, 254), KEEP_OUT)
    zones = zones_of_mask(path, "dock")
    if not is_black.any():
        assert zones == []
        return
    [zone] = zones
    assert (zone.name, zone.kind) == ("dock", ZoneKind.KEEP_OUT)
    assert (cells_of(zone, is_black.shape) == is_black).all()
    assert zone.area_m2 == pytest.approx(0.01 * is_black.sum(), rel=1e-6)


def test_a_thin_line_of_a_fine_mask_holds_on_the_cells_of_the_team(tmp_path):
    pixels = np.full((40, 40), 254)
    pixels[:, 21] = 0
    [zone] = zones_of_mask(write(tmp_path, pixels, KEEP_OUT, 0.05), "line")
    held = cells_of(zone, (20, 20))
    assert held[:, 10].all()
    assert held.sum() == 20


def test_grey_and_unknown_cells_are_passed_by_a_keep_out_mask(tmp_path):
    pixels = np.full((10, 10), 254)
    pixels[2, 2], pixels[4, 4], pixels[6, 6] = 205, 120, 0
    [zone] = zones_of_mask(write(tmp_path, pixels, KEEP_OUT), "z")
    assert np.argwhere(cells_of(zone, (10, 10))).tolist() == [[6, 6]]


def test_a_speed_mask_has_a_zone_for_each_limit(tmp_path):
    """127 is 50 per cent dark, 191 is 25, white is 0 and black 100."""
    pixels = np.full((10, 20), 255)
    pixels[:4, :5], pixels[6:, :5], pixels[:, 12:15] = 127, 191, 0
    path = write(tmp_path, pixels, SPEED)
    of_fastest = zones_of_mask(path, "slow", SpeedScale(100.0, -1.0, 0.6))
    assert [(zone.name, zone.speed_m_s) for zone in of_fastest] == [
        ("slow-25", pytest.approx(0.45)),
        ("slow-50", pytest.approx(0.3)),
    ]
    assert (cells_of(of_fastest[1], pixels.shape) == (pixels == 127)).all()
    absolute = zones_of_mask(path, "slow", SpeedScale(0.0, 0.01))
    limits_m_s = {zone.name: zone.speed_m_s for zone in absolute}
    assert limits_m_s == {"slow-25": 0.25, "slow-50": 0.5, "slow-100": 1.0}
    assert zones_of_mask(path, "slow", SpeedScale(200.0, 1.0, 0.6)) == []


def test_a_file_that_is_no_mask_is_refused(tmp_path):
    (tmp_path / "mask.yaml").write_text("image: mask.pgm\n")
    with pytest.raises(MapError, match=r"mask\.yaml"):
        zones_of_mask(tmp_path / "mask.yaml", "z")
