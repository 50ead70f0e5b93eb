import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from robrain.sim.maps.errors import MapError
from robrain.sim.maps.map_server import load_map
from tests.real_maps import REAL_MAPS, needs_real_maps

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


def test_unknown_pixels_are_wall_and_thresholds_are_exclusive(tmp_path: Path) -> None:
    # p = (255 − v) / 255: 0.2, 0.4 and 0.8 exactly.
    image = _grey([204, 153, 51, 255])
    assert load_map(_write(tmp_path, image)).occupied.tolist() == [[False, True, True, False]]
    at_threshold = _write(tmp_path, image, free_thresh=0.2)
    assert load_map(at_threshold).occupied.tolist() == [[True, True, True, False]]


@pytest.mark.parametrize("negate", [1, True])
def test_negated_map_is_free_where_black(tmp_path: Path, negate: object) -> None:
    plan = load_map(_write(tmp_path, _grey([0, 255, 100]), negate=negate))
    assert plan.occupied.tolist() == [[False, True, True]]


@pytest.mark.parametrize("mode", ["1", "L", "RGB", "RGBA", "LA", "P", "I;16"])
def test_every_kind_of_png_reads_alike(tmp_path: Path, mode: str) -> None:
    grey = _grey([0, 255, 255], [255, 255, 0])
    sixteen_bit = Image.fromarray(np.asarray(grey, dtype=np.uint16) * 257)
    image = sixteen_bit if mode == "I;16" else grey.convert(mode)
    plan = load_map(_write(tmp_path, image))
    assert plan.occupied.tolist() == [[False, False, True], [True, False, False]]


def test_colours_are_averaged(tmp_path: Path) -> None:
    pixels = np.array([[[255, 255, 150], [255, 0, 0]]], dtype=np.uint8)
    assert load_map(_write(tmp_path, Image.fromarray(pixels))).occupied.tolist() == [[False, True]]


def test_transparent_pixels_are_unknown_in_scale_mode(tmp_path: Path) -> None:
    pixels = np.array([[[255, 255, 255, 200], [255, 255, 255, 255]]], dtype=np.uint8)
    path = _write(tmp_path, Image.fromarray(pixels))
    assert load_map(path).occupied.tolist() == [[False, False]]
    path = _write(tmp_path, Image.fromarray(pixels), mode="scale")
    assert load_map(path).occupied.tolist() == [[True, False]]


def test_binary_and_plain_pgm_are_read(tmp_path: Path) -> None:
    for content in (b"P5\n2 1\n255\n\x00\xff", b"P2\n2 1\n255\n0 255\n"):
        (tmp_path / "map.pgm").write_bytes(content)
        plan = load_map(_write(tmp_path, None, image="map.pgm"))
        assert plan.occupied.tolist() == [[True, False]]


@pytest.mark.parametrize(
    ("changes", "key", "expected"),
    [
        *[({key: None}, key, "missing") for key in SETTINGS],
        ({"colour": "red"}, "colour", "unknown key"),
        ({"image": 5}, "image", "path of an image"),
        ({"image": "none.png"}, "image", "there is none"),
        ({"image": "."}, "image", "readable"),
        ({"resolution": 0}, "resolution", "above 0"),
        ({"resolution": -0.05}, "resolution", "above 0"),
        ({"resolution": "fine"}, "resolution", "a number"),
        ({"resolution": True}, "resolution", "a number"),
        ({"resolution": float("nan")}, "resolution", "a number"),
        ({"resolution": 10**400}, "resolution", "a number"),
        ({"resolution": float("inf")}, "resolution", "a number"),
        ({"resolution": 50}, "resolution", "from 0.001 to 1 m a cell, got 50"),
        ({"resolution": 1e-9}, "resolution", "from 0.001 to 1 m a cell, got 1e-09"),
        ({"resolution": "7" * 50_000}, "resolution", "a number, got '777"),
        ({"resolution": [[0.05] * 1000] * 1000}, "resolution", "a number, got"),
        ({"origin": [float("nan"), 0, 0]}, "origin", r"\[x, y, yaw\]"),
        ({"origin": [1e300, 0, 0]}, "origin", "within 100000 m of 0"),
        ({"origin": [0, -1e6, 0]}, "origin", "within 100000 m of 0"),
        ({"origin": [0, 0, float("nan")]}, "origin", r"\[x, y, yaw\]"),
        ({"occupied_thresh": float("nan")}, "occupied_thresh", "from 0 to 1"),
        ({"free_thresh": "low"}, "free_thresh", "from 0 to 1"),
        ({"negate": 1.0}, "negate", "0 or 1"),
        ({"negate": [0]}, "negate", "0 or 1"),
        ({"mode": ["scale"]}, "mode", "trinary or scale"),
        ({"image": "a\0b.png"}, "image", "path of an image"),
        ({"image": "x" * 5000 + ".png"}, "image", "path of an image"),
        ({"image": "/dev/zero"}, "image", "readable PGM or PNG"),
        ({"origin": [0, 0]}, "origin", r"\[x, y, yaw\]"),
        ({"origin": 3}, "origin", r"\[x, y, yaw\]"),
        ({"origin": [0, "a", 0]}, "origin", r"\[x, y, yaw\]"),
        ({"origin": [0, 0, 0.1]}, "origin", "rotated map is not supported"),
        ({"negate": 2}, "negate", "0 or 1"),
        ({"negate": "no"}, "negate", "0 or 1"),
        ({"occupied_thresh": 65}, "occupied_thresh", "from 0 to 1"),
        ({"free_thresh": -0.1}, "free_thresh", "from 0 to 1"),
        ({"free_thresh": 0.7}, "free_thresh", "at most occupied_thresh"),
        ({"mode": "raw"}, "mode", "raw values do not say"),
        ({"mode": 3}, "mode", "trinary or scale"),
    ],
)
def test_bad_setting_is_named_with_what_was_expected(
    tmp_path: Path, changes: dict[str, object], key: str, expected: str
) -> None:
    path = _write(tmp_path, _grey([255, 0]), **changes)
    with pytest.raises(MapError, match=expected) as caught:
        load_map(path)
    assert (caught.value.path, caught.value.key) == (path, key)
    assert str(path) in str(caught.value)
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is empty"),
        (b"# nothing\n", "is empty"),
        (b"- image\n- map.png\n", "expected a mapping of keys, got a list"),
        (b"image: [unclosed", "expected valid YAML"),
        (b"\xff\xfe\xfa", "expected a readable YAML file"),
        (b"[" * 20_000, "expected valid YAML"),
        (b"resolution: " + b"9" * 5000, "expected valid YAML"),
        (b"resolution: 2020-13-45", "expected valid YAML"),
        (b"image: " + b"a" * 200_000, "expected at most 65536 bytes of YAML"),
    ],
)
def test_file_that_is_no_map_is_told_in_one_sentence(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_bytes(content)
    with pytest.raises(MapError, match=expected) as caught:
        load_map(path)
    assert caught.value.path == path
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder_are_told(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="there is none"):
        load_map(tmp_path / "none.yaml")
    with pytest.raises(MapError, match="readable YAML file"):
        load_map(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"no image", b"\x89PNG\r\n\x1a\n", b"P5\n9 9\n255\n\x00", b"P5\n0 0\n255\n", b"P5\nx"]
)
def test_unreadable_image_is_told(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.png").write_bytes(content)
    with pytest.raises(MapError, match="image: expected a readable PGM or PNG") as caught:
        load_map(_write(tmp_path, None))
    assert caught.value.key == "image"


def test_image_cut_short_is_told(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (40, 40), dtype=np.uint8)
    path = _write(tmp_path, Image.fromarray(noise))
    whole = (tmp_path / "map.png").read_bytes()
    (tmp_path / "map.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MapError, match="expected a readable PGM or PNG"):
        load_map(path)


def test_image_without_free_space_is_told(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"expected free space in map\.png, got none") as caught:
        load_map(_write(tmp_path, _grey([0, 0], [120, 0])))
    assert caught.value.key == "image"


@needs_real_maps
@pytest.mark.parametrize(
    ("name", "size_m", "free_share"),
    [
        ("nav2_depot", (30.2, 15.35), 0.97),
        ("stage_autolab", (19.98, 17.02), 0.956),
        ("stage_cave", (16.0, 16.0), 0.979),
        ("stage_hospital_section", (40.18, 16.39), 0.964),
    ],
)
def test_real_map_has_its_known_size_and_share_of_free_cells(
    name: str, size_m: tuple[float, float], free_share: float
) -> None:
    plan = load_map(REAL_MAPS / f"{name}.yaml")
    assert plan.size_m == pytest.approx(size_m, abs=0.01)
    assert (~plan.occupied).mean() == pytest.approx(free_share, abs=0.005)


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
    with pytest.raises(MapError, match="image: expected at most 20000000 pixels") as caught:
        load_map(path)
    assert caught.value.key == "image"


def test_a_floor_that_a_team_cannot_map_is_refused_before_it_is_made(tmp_path: Path) -> None:
    path = _write(tmp_path, Image.new("L", (3000, 3000), 255), resolution=0.5)
    with pytest.raises(
        MapError, match="resolution: expected a floor of at most 167772 m², got 1500 × 1500 m"
    ) as caught:
        load_map(path)
    assert (caught.value.path, caught.value.key) == (path, "resolution")
