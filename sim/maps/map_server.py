"""Maps in the ROS map_server format: a YAML file beside a PGM or PNG image.

Keys, thresholds and modes as in https://wiki.ros.org/map_server and Nav2's map_io. With v the mean of the channels in
0–255, occupancy p = 1 − v / 255, or v / 255 if negated. By mode, a cell is free:

- trinary: if p < free_thresh; the mean includes alpha.
- scale: if p, mapped linearly from free_thresh–occupied_thresh to 0–100 and rounded, is at most 0; transparent cells
  are unknown.
- raw: if v, which is an occupancy in per cent, is at most 100 · free_thresh; negate has no effect.

A floor plan holds all other cells, occupied and unknown ones, for wall.
"""

import logging
import math
import warnings
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from robrain.sim.maps.floor_plan import MAX_CELLS, MAX_ORIGIN_M, FloorPlan, MapError, size_refusal

REQUIRED_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
OPTIONAL_KEYS = ("mode",)
MODES = ("trinary", "scale", "raw")
RESOLUTION_M = (0.001, 1.0)
"""Least and greatest pitch; any other pitch is an error of units or not a floor for robots."""
YAML_BYTES_MAX = 65536
PATH_CHARACTERS_MAX = 1000
SHOWN_CHARACTERS = 80
"""Length to which an error message cuts a refused value."""
GREY = 0.1
"""Occupancy from which a cell looks grey, thus hardly meant as free floor; map_saver's unknown cells have 0.196."""
DOUBTFUL_SHARE = 0.005
"""Share of cells from which a doubtful colour is worth a warning; the edges of a drawn wall have less."""

logger = logging.getLogger(__name__)


def load_map(path: Path) -> FloorPlan:
    """The floor plan of a map_server YAML file, named after the file.

    The image's path is taken relative to the YAML file. Raises MapError for anything that cannot be read as such a map
    or has no free space. Its sentence names the file, the key and the expected value.
    """
    settings = _Settings(path)
    image_path = path.parent / settings.file_name("image")
    resolution_m = settings.number("resolution")
    if resolution_m <= 0:
        raise settings.error("resolution", "a number of metres above 0")
    if not RESOLUTION_M[0] <= resolution_m <= RESOLUTION_M[1]:
        raise settings.error("resolution", f"from {RESOLUTION_M[0]:g} to {RESOLUTION_M[1]:g} m a cell")
    origin_x_m, origin_y_m = settings.origin()
    negate = settings.flag("negate")
    occupied_thresh = settings.share("occupied_thresh")
    free_thresh = settings.share("free_thresh")
    if free_thresh > occupied_thresh:
        raise settings.error("free_thresh", f"at most occupied_thresh, which is {occupied_thresh:g}")
    mode = settings.mode()

    value, transparent = _read_image(path, image_path, mode, resolution_m)
    occupancy = value / 255 if negate else 1 - value / 255
    if mode == "raw":
        free = np.round(value) <= 100 * free_thresh
    elif mode == "scale":
        free = (100 * (occupancy - free_thresh) <= 0.5 * (occupied_thresh - free_thresh)) & ~transparent
    else:
        free = occupancy < free_thresh
    shade = "unknown" if mode == "scale" else "dark"
    see_through = f"{transparent.mean():.1%} of the pixels are transparent, which mode {mode} reads as {shade}"
    if not free.any():
        hint = f"; {see_through}: draw the floor in white" if transparent.any() else ""
        raise MapError(
            f"{path}: image: expected free space in {image_path.name}, got none{hint}", path=path, key="image"
        )
    if mode != "scale" and (transparent & ~free).mean() >= DOUBTFUL_SHARE:
        logger.warning("%s: image: %s, thus wall. Draw them in white if they are floor.", path, see_through)
    grey = free & (occupancy >= GREY) & (mode != "raw")
    counts = np.bincount(np.round(value[grey]).astype(np.int64), minlength=1)
    if counts.max() >= DOUBTFUL_SHARE * value.size:
        share, below = counts.max() / value.size, math.floor(1000 * occupancy[grey].min()) / 1000
        logger.warning(
            "%s: free_thresh: %.1f %% of the cells are grey, %d of 255, and become free floor. "
            "If they are unknown, as map_saver writes it, set free_thresh to %g instead of %g.",
            *(path, 100 * share, counts.argmax(), below, free_thresh),
        )
    # An image's row 0 is at the top, the grid's at the lowest y.
    return FloorPlan(np.flipud(~free), resolution_m, origin_x_m, origin_y_m, path.stem)


class _Settings:
    """The YAML file's mapping, read key by key."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._values = self._read()
        for key in REQUIRED_KEYS:
            if key not in self._values:
                raise MapError(f"{path}: expected key {key}, which is missing", path=path, key=key)
        for key in self._values:
            if key not in REQUIRED_KEYS + OPTIONAL_KEYS:
                known = ", ".join(REQUIRED_KEYS + OPTIONAL_KEYS)
                raise MapError(f"{path}: {key}: unknown key, expected one of {known}", path=path, key=key)

    def _read(self) -> dict[str, object]:
        path = self._path
        try:
            with path.open("rb") as file:
                text = file.read(YAML_BYTES_MAX + 1)
            if len(text) > YAML_BYTES_MAX:
                raise MapError(f"{path}: expected at most {YAML_BYTES_MAX} bytes of YAML, got more", path=path)
            # PyYAML refuses a tab after a colon, which YAML allows. No map needs one.
            content: object = yaml.safe_load(text.decode("utf-8-sig").replace("\t", " "))
        except FileNotFoundError as error:
            raise MapError(f"{path}: expected a map_server YAML file, there is none", path=path) from error
        except MapError:
            raise
        except (OSError, UnicodeDecodeError) as error:
            raise MapError(f"{path}: expected a readable YAML file, got: {_one_line(error)}", path=path) from error
        # Besides its own errors PyYAML lets Python's through: ValueError for a date in month 13 or a number of 5000
        # digits, RecursionError for deep nesting.
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise MapError(f"{path}: expected valid YAML, got: {_one_line(error)}", path=path) from error
        if content is None:
            raise MapError(f"{path}: expected the keys of a map, the file is empty", path=path)
        if not isinstance(content, dict):
            raise MapError(f"{path}: expected a mapping of keys, got a {type(content).__name__}", path=path)
        return {str(key): value for key, value in content.items()}

    def error(self, key: str, expected: str) -> MapError:
        got = repr(self._values[key])
        if len(got) > SHOWN_CHARACTERS:
            got = f"{got[:SHOWN_CHARACTERS]}…"
        return MapError(f"{self._path}: {key}: expected {expected}, got {got}", path=self._path, key=key)

    def file_name(self, key: str) -> str:
        value = self._values[key]
        if not isinstance(value, str) or not 0 < len(value) <= PATH_CHARACTERS_MAX or "\0" in value:
            raise self.error(key, "the path of an image")
        return value

    def number(self, key: str) -> float:
        value = _as_number(self._values[key])
        if value is None:
            raise self.error(key, "a number")
        return value

    def share(self, key: str) -> float:
        value = _as_number(self._values[key])
        if value is None or not 0 <= value <= 1:
            raise self.error(key, "a number from 0 to 1")
        return value

    def flag(self, key: str) -> bool:
        value = self._values[key]
        if not isinstance(value, bool | int) or value not in (0, 1):
            raise self.error(key, "0 or 1")
        return bool(value)

    def origin(self) -> tuple[float, float]:
        listed = self._values["origin"]
        numbers = [_as_number(value) for value in listed] if isinstance(listed, list) else []
        x_m, y_m, yaw_rad = numbers if len(numbers) == 3 else (None, None, None)
        if x_m is None or y_m is None or yaw_rad is None:
            raise self.error("origin", "[x, y, yaw] in metres and radians")
        if yaw_rad != 0:
            raise self.error("origin", "yaw 0, since a rotated map is not supported")
        if max(abs(x_m), abs(y_m)) > MAX_ORIGIN_M:
            raise self.error("origin", f"x and y within {MAX_ORIGIN_M:.0f} m of 0")
        return x_m, y_m

    def mode(self) -> str:
        value = self._values.get("mode", MODES[0])
        if not isinstance(value, str) or value.lower() not in MODES:
            raise self.error("mode", "trinary, scale or raw")
        return value.lower()


def _as_number(value: object) -> float | None:
    # YAML's true is an int to Python; a map that says `resolution: yes` is wrong. PyYAML reads 5e-2 as text.
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _read_image(
    yaml_path: Path, image_path: Path, mode: str, resolution_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Mean of the channels, (H, W) in 0–255, and which pixels are transparent, (H, W)."""
    too_many = f"{yaml_path}: image: expected at most {MAX_CELLS} pixels at {image_path}"
    try:
        if image_path.exists() and not image_path.is_file():  # reading a device or pipe might never end
            raise OSError("it is not a file")
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(image_path)
        with image:
            width, height = image.size
            if width * height > MAX_CELLS:
                raise MapError(f"{too_many}, got {width} × {height}", path=yaml_path, key="image")
            if why := size_refusal(width * resolution_m, height * resolution_m):
                raise MapError(f"{yaml_path}: resolution: {why}", path=yaml_path, key="resolution")
            image.load()
            return _channel_mean(image, alpha_counts=mode == "trinary")
    except MapError:
        raise
    except FileNotFoundError as error:
        message = f"{yaml_path}: image: expected an image at {image_path}, there is none"
        raise MapError(message, path=yaml_path, key="image") from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise MapError(f"{too_many}, got: {_one_line(error)}", path=yaml_path, key="image") from error
    # Pillow's decoders raise these for files that are truncated, empty or not an image.
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        message = f"{yaml_path}: image: expected a readable PGM or PNG at {image_path}, got: {_one_line(error)}"
        raise MapError(message, path=yaml_path, key="image") from error


def _channel_mean(image: Image.Image, *, alpha_counts: bool) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    if 0 in image.size:
        raise ValueError("an image without pixels")
    if image.mode.startswith("I"):
        value = np.asarray(image, dtype=np.float64) / 257
        return value, np.zeros(value.shape, dtype=np.bool_)
    if "A" in image.mode or "transparency" in image.info:
        channels = np.asarray(image.convert("RGBA"), dtype=np.float64)
        # map_server and Nav2 both average alpha in for trinary, and for scale read it as "unknown".
        value = channels.mean(axis=2) if alpha_counts else channels[:, :, :3].mean(axis=2)
        return value, channels[:, :, 3] < 255
    value = np.asarray(image.convert("RGB"), dtype=np.float64).mean(axis=2)
    return value, np.zeros(value.shape, dtype=np.bool_)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
