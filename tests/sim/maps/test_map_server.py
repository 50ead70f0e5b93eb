import itertools
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from robrain.recording.errors import MapError
from robrain.sim.maps.floor_plan import load_map

SETTINGS = {
    "image": "map.png",
    "resolution": 0.5,
    "origin": [-1.0, 2, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.25,
}


def _write(folder: Path, image: Image.Image | None, /, **changes: object) -> Path:
    """A map in the folder, its settings changed as told; a setting of None is left out."""
    if image is not None:
        image.save(folder / "map.png")
    settings = {key: value for key, value in (SETTINGS | changes).items() if value is not None}
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def _grey(*rows: list[int]) -> Image.Image:
    return Image.fromarray(np.array(rows, dtype=np.uint8))


def test_top_row_of_the_image_has_the_highest_y(tmp_path: Path) -> None:
    plan = load_map(_write(tmp_path, _grey([0, 255], [255, 255], [255, 255])))
    assert plan.occupied.tolist() == [[False, False], [False, False], [True, False]]
    assert (plan.resolution_m, plan.origin_x_m, plan.origin_y_m, plan.name) == (0.5, -1.0, 2.0, "lab")


def _is_free_in_nav2(
    grey: int, alpha: int | None, mode: str, *, negate: bool, occupied_thresh: float, free_thresh: float
) -> bool:
    """Whether Nav2's map_server publishes 0, free, for a pixel; in mode raw, whether its map_saver calls that free."""
    channels = [grey] * 3 + ([alpha] if mode == "trinary" and alpha is not None else [])
    shade = sum(channels) / len(channels) / 255
    occupancy = shade if negate else 1 - shade
    if mode == "raw":
        return round(shade * 255) <= 100 * free_thresh
    if mode == "scale" and alpha not in (None, 255):
        return False
    if occupied_thresh < occupancy:
        return False
    if occupancy < free_thresh:
        return True
    return mode == "scale" and round((occupancy - free_thresh) / (occupied_thresh - free_thresh) * 100) == 0


ALPHAS = (None, 0, 128, 255)
THRESHOLDS = ((0.65, 0.196), (0.65, 0.25), (0.65, 0.2), (0.9, 0.6), (0.5, 0.0), (1.0, 0.8))
GREYS = (0, 12, 24, 25, 26, 49, 50, 51, 63, 64, 100, 101, 127, 128, 190, 191, 200, 204, 205, 206, 230, 254, 255)


@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw", "Scale", None])
def test_cells_are_free_where_nav2_reads_them_as_free(tmp_path: Path, mode: str | None, negate: bool) -> None:
    for alpha, thresholds in itertools.product(ALPHAS, THRESHOLDS):
        known = {"negate": negate, "occupied_thresh": thresholds[0], "free_thresh": thresholds[1]}
        wanted = [_is_free_in_nav2(grey, alpha, (mode or "trinary").lower(), **known) for grey in GREYS]
        pixels = np.array([[(grey, *([] if alpha is None else [alpha])) for grey in GREYS]], dtype=np.uint8)
        path = _write(tmp_path, Image.fromarray(pixels if alpha is not None else pixels[:, :, 0]), mode=mode, **known)
        if any(wanted):
            assert (~load_map(path).occupied[0]).tolist() == wanted, (alpha, thresholds)
        else:
            with pytest.raises(MapError, match="expected free space"):
                load_map(path)


@pytest.mark.parametrize(
    ("pixels", "changes", "expected"),
    [
        (
            [(205,), (205,), (254,), (0,)],
            {},
            "50.0 % of the cells are grey, 205 of 255, .* set free_thresh to 0.196 instead of 0.25",
        ),
        ([(50,), (255,), (0,), (0,)], {"negate": 1}, "25.0 % of the cells are grey, 50 "),
        ([(205,), (254,), (0,), (0,)], {"mode": "scale", "free_thresh": 0.196}, "grey, 205 of 255, .* to 0.196 "),
        (
            [(205, 0), (255, 255)],
            {"free_thresh": 0.26},
            "50.0% of the pixels are transparent, which mode trinary reads as",
        ),
        ([(255, 0), (255, 255)], {"free_thresh": 0.26}, "50.0 % of the cells are grey, 191 "),
        ([(205,), (254,), (0,)], {"free_thresh": 0.196}, ""),
        ([(230,), (254,), (0,)], {}, ""),
        ([(205, 0), (255, 255)], {"mode": "scale"}, ""),
        ([(0,), (100,), (255,)], {"mode": "raw"}, ""),
        ([*[(255,)] * 300, (205,)], {}, ""),
    ],
)
def test_colours_that_do_not_fit_the_thresholds_are_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, pixels: list[tuple[int, ...]], changes: dict, expected: str
) -> None:
    array = np.array([pixels], dtype=np.uint8)
    load_map(_write(tmp_path, Image.fromarray(array if array.shape[2] == 2 else array[:, :, 0]), **changes))
    assert re.search(expected, caplog.text) if expected else not caplog.records


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *[(key, None) for key in SETTINGS],
        ("colour", "red"),
        *[("image", value) for value in (5, "none.png", ".", "a\0b.png", "x" * 5000 + ".png", "/dev/zero")],
        *[("resolution", value) for value in (0, -0.05, "fine", True, float("nan"), 10**400, 50, 1e-9, "7" * 50_000)],
        *[("origin", value) for value in (3, [0, 0], [0, "a", 0], [float("nan"), 0, 0], [1e300, 0, 0], [0, -1e6, 0])],
        *[("origin", value) for value in ([0, 0, float("nan")], [0, 0, 0.1])],
        *[("negate", value) for value in (2, "nay", [0])],
        *[("occupied_thresh", value) for value in (float("nan"), 65)],
        *[("free_thresh", value) for value in ("low", -0.1, 0.7)],
        *[("mode", value) for value in (3, ["scale"], "grey")],
    ],
)
def test_bad_setting_is_refused_with_file_and_key(tmp_path: Path, key: str, value: object) -> None:
    path = _write(tmp_path, _grey([255, 0]), **{key: value})
    with pytest.raises(MapError, match=key) as caught:
        load_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"- image\n- map.png\n",
        b"image: [unclosed",
        b"\xff\xfe\xfa",
        b"[" * 20_000,
        b"resolution: " + b"9" * 5000,
        b"resolution: 2020-13-45",
        b"image: " + b"a" * 200_000,
    ],
)
def test_file_that_is_no_map_is_refused_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "lab.yaml"
    path.write_bytes(content)
    with pytest.raises(MapError, match=str(path)) as caught:
        load_map(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"no image", b"\x89PNG\r\n\x1a\n", b"P5\n9 9\n255\n\x00", b"P5\n0 0\n255\n", b"P5\nx"]
)
def test_unreadable_image_is_told(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.png").write_bytes(content)
    with pytest.raises(MapError, match="image: expected a readable PGM or PNG"):
        load_map(_write(tmp_path, None))


def _header_of_png(width: int, height: int) -> bytes:
    """A PNG that claims a size, without any pixels."""
    head = struct.pack(">4sIIBBBBB", b"IHDR", width, height, 8, 0, 0, 0, 0)
    ends = struct.pack(">I4s", 0, b"IEND")
    sums = zlib.crc32(head), zlib.crc32(b"IEND")
    return (
        b"\x89PNG\r\n\x1a\n"
        + struct.pack(">I", 13)
        + head
        + struct.pack(">I", sums[0])
        + ends
        + struct.pack(">I", sums[1])
    )


@pytest.mark.parametrize(
    "content",
    [
        _header_of_png(6000, 6000),
        _header_of_png(11_000, 11_000),  # Pillow warns
        _header_of_png(60_000, 60_000),  # Pillow refuses
        b"P5\n5000 5000\n255\n",
    ],
)
def test_an_image_of_too_many_pixels_is_refused_before_it_is_decoded(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.png").write_bytes(content)
    path = _write(tmp_path, None)
    with pytest.raises(MapError, match="image: expected at most 20000000 pixels"):
        load_map(path)


def test_a_floor_that_a_team_cannot_map_is_refused_before_it_is_made(tmp_path: Path) -> None:
    path = _write(tmp_path, Image.new("L", (3000, 3000), 255), resolution=0.5)
    with pytest.raises(MapError, match="resolution: expected a floor of at most 167772 m²"):
        load_map(path)
