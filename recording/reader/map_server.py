"""Maps in the ROS map_server format: a YAML file beside a PGM or PNG image.

Keys, thresholds and modes as in https://wiki.ros.org/map_server and Nav2's map_io. With v the mean of the channels in
0–255, occupancy p = 1 − v / 255, or v / 255 if negated. By mode, a cell is free:

- trinary: if p < free_thresh; the mean includes alpha.
- scale: if p, mapped linearly from free_thresh–occupied_thresh to 0–100 and rounded, is at most 0; transparent cells
  are unknown.
- raw: if v, which is an occupancy in per cent, is at most 100 · free_thresh; negate has no effect.
"""

import logging
import math
import warnings
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import yaml
from msgspec import Meta
from numpy.typing import NDArray
from PIL import Image

from robrain.algorithms.mapping.patch_cells import MAX_CELLS as MAX_TEAM_CELLS
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Share
from robrain.recording.errors import MapError

TEAM_RESOLUTION_M = 0.1
"""Pitch of the team's grid on a simulated floor."""
MAX_CELLS = 20_000_000
"""Largest number of cells of a floor plan."""
MAX_AREA_M2 = MAX_TEAM_CELLS * TEAM_RESOLUTION_M**2
MAX_ORIGIN_M = 1e5
"""Largest distance of a floor's origin from 0, along each axis."""
YAML_BYTES_MAX = 65536
GREY = 0.1
"""Occupancy from which a cell looks grey, thus hardly meant as free floor; map_saver's unknown cells have 0.196."""
DOUBTFUL_SHARE = 0.005
"""Share of cells from which a doubtful colour is worth a warning; the edges of a drawn wall have less."""

logger = logging.getLogger(__name__)


class MapSettings(Checked, frozen=True, forbid_unknown_fields=True):
    """Keys of the YAML file."""

    image: Annotated[str, Meta(min_length=1, max_length=1000, pattern="^[^\\0]*$")]
    """Path relative to the YAML file."""
    resolution: Annotated[float, Meta(ge=0.001, le=1.0)]
    """Metres a cell; any other pitch is an error of units or not a floor for robots."""
    origin: tuple[float, float, float]
    """x and y of the lower left corner, metres, and yaw, which must be 0."""
    negate: bool
    occupied_thresh: Share
    free_thresh: Share
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    def __post_init__(self) -> None:
        super().__post_init__()
        x_m, y_m, yaw_rad = self.origin
        if yaw_rad != 0:
            raise ValueError(f"expected origin with yaw 0, since a rotated map is not supported, got {yaw_rad:g}")
        if not max(abs(x_m), abs(y_m)) <= MAX_ORIGIN_M:
            raise ValueError(f"expected x and y of origin within {MAX_ORIGIN_M:.0f} m of 0, got {x_m:g}, {y_m:g}")
        if self.free_thresh > self.occupied_thresh:
            raise ValueError(f"expected free_thresh at most occupied_thresh, {self.occupied_thresh:g}")


def read_free(path: Path) -> tuple[NDArray[np.bool_], MapSettings]:
    """Free cells of a map as a floor plan has them, (H, W), row 0 at the lowest y; all others are wall.

    The image's path is taken relative to the YAML file. Raises MapError for anything that cannot be read as such a map
    or has no free space. Its sentence names the file, the key and the expected value.
    """
    settings = _read_settings(path)
    image_path = path.parent / settings.image
    free_thresh, occupied_thresh, mode = settings.free_thresh, settings.occupied_thresh, settings.mode
    value, transparent = _read_image(path, image_path, mode, settings.resolution)
    occupancy = value / 255 if settings.negate else 1 - value / 255
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
        raise MapError(f"{path}: image: expected free space in {image_path.name}, got none{hint}")
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
    return np.flipud(free), settings  # an image's row 0 is at the top


def read_occupancy(path: Path) -> tuple[NDArray[np.int64], MapSettings]:
    """Occupancies as Nav2 reads them (MapError): per cent, −1 for unknown, (H, W), row 0 at the lowest y."""
    settings = _read_settings(path)
    low, high, mode = settings.free_thresh, settings.occupied_thresh, settings.mode
    value, transparent = _read_image(path, path.parent / settings.image, mode, settings.resolution)
    if mode == "raw":
        return np.flipud(np.where(value > 100, -1, np.rint(value)).astype(np.int64)), settings
    occupancy = value / 255 if settings.negate else 1 - value / 255
    between = -1.0 if mode == "trinary" else np.rint(100 * (occupancy - low) / max(high - low, 1e-9))
    percent = np.where(occupancy >= high, 100, np.where(occupancy <= low, 0, between))
    return np.flipud(np.where(transparent & (mode == "scale"), -1, percent).astype(np.int64)), settings


def _read_settings(path: Path) -> MapSettings:
    try:
        with path.open("rb") as file:
            text = file.read(YAML_BYTES_MAX + 1)
        if len(text) > YAML_BYTES_MAX:
            raise MapError(f"{path}: expected at most {YAML_BYTES_MAX} bytes of YAML, got more")
        # PyYAML refuses a tab after a colon, which YAML allows. No map needs one.
        content: object = yaml.safe_load(text.decode("utf-8-sig").replace("\t", " "))
        if isinstance(content, dict):
            content = {key: value if key == "image" else _plain(value) for key, value in content.items()}
        return msgspec.convert(content, MapSettings, strict=False)
    except FileNotFoundError as error:
        raise MapError(f"{path}: expected a map_server YAML file, found none") from error
    except msgspec.ValidationError as error:
        what, _, key = str(error).partition(" - at `$.")
        raise MapError(f"{path}: {key.rstrip('`')}{': ' if key else ''}{_one_line(what)}") from error
    except MapError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(f"{path}: expected a readable YAML file, got: {_one_line(error)}") from error
    # Besides its own errors PyYAML lets Python's through: ValueError for a date in month 13 or a number of 5000
    # digits, RecursionError for deep nesting.
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise MapError(f"{path}: expected valid YAML, got: {_one_line(error)}") from error


def _plain(value: object) -> object:
    """A value as other readers of maps have it: PyYAML reads 5e-2 as text, and a mode may have capitals."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value.lower() if isinstance(value, str) else value


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
                raise MapError(f"{too_many}, got {width} × {height}")
            if reason := size_refusal(width * resolution_m, height * resolution_m):
                raise MapError(f"{yaml_path}: resolution: {reason}")
            image.load()
            return _channel_mean(image, alpha_counts=mode == "trinary")
    except MapError:
        raise
    except FileNotFoundError as error:
        message = f"{yaml_path}: image: expected an image at {image_path}, found none"
        raise MapError(message) from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise MapError(f"{too_many}, got: {_one_line(error)}") from error
    # Pillow's decoders raise these for files that are truncated, empty or not an image.
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        message = f"{yaml_path}: image: expected a readable PGM or PNG at {image_path}, got: {_one_line(error)}"
        raise MapError(message) from error


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


def _one_line(error: Exception | str) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


def size_refusal(width_m: float, height_m: float) -> str:
    """The error text for a floor too large to map; empty if a team can map it."""
    if width_m * height_m <= MAX_AREA_M2:
        return ""
    return f"expected a floor of at most {MAX_AREA_M2:.0f} m², got {width_m:g} × {height_m:g} m"
