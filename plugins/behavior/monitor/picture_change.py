"""Picture change: how much of a picture is not as it was, looked at from the same place.

The robot does not stand and face quite as it did: the pictures are first shifted to agree as well as they can (turning
a camera by a little shifts its picture). Then a pixel counts as changed if no pixel next to it was as it is now, and
all around it have changed as well: edges that have moved a little leave lines, what has come leaves an area.
"""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

HALF = 2
SHIFT_MAX = 8
"""Of the picture at half its size, to either side: 16 pixels of 160 are some 7 degrees."""
CHANGED_LEVELS = 22.0
"""A pixel has changed when a colour of it differs by more than this, of 255. Chosen; the noise makes some 3."""


def colors_of(png: bytes) -> NDArray[np.float64]:
    """Colours (H / 2, W / 2, 3), 0 to 255; a picture's pixels averaged two by two.

    Raises:
        ModuleNotFoundError: pillow is not installed.
        OSError: it is no picture.

    """
    from PIL import Image  # a robot without a camera does without it

    with Image.open(io.BytesIO(png)) as picture:
        pixels: NDArray[Any] = np.asarray(picture.convert("RGB"), np.float64)
    rows, columns = pixels.shape[0] // HALF, pixels.shape[1] // HALF
    halves = pixels[: rows * HALF, : columns * HALF].reshape(rows, HALF, columns, HALF, 3)
    return np.asarray(halves.mean(axis=(1, 3)))


def changed_share(before: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    """Share of the picture that has changed, 0 to 1; 1 if the pictures are not of one size. Both as of `colors_of`."""
    if before.shape != now.shape:
        return 1.0
    shift = min(
        range(-SHIFT_MAX, SHIFT_MAX + 1),
        key=lambda each: (np.abs(_part(before, 0, 0) - _part(now, each, 0)).mean(), abs(each)),
    )
    here = _part(now, shift, 0)
    around = [_part(before, across, down) for across in (-1, 0, 1) for down in (-1, 0, 1)]
    changed = np.min([np.abs(here - part).max(axis=2) for part in around], axis=0) > CHANGED_LEVELS
    rows, columns = changed.shape
    whole = np.ones((rows - 2, columns - 2), np.bool_)
    for down in range(3):
        for across in range(3):
            whole &= changed[down : rows - 2 + down, across : columns - 2 + across]
    return float(np.mean(whole))


def _part(colors: NDArray[np.float64], across: int, down: int) -> NDArray[np.float64]:
    """The part that two pictures have in common in all shifts, shifted by so many pixels."""
    edge = SHIFT_MAX + 1
    rows, columns = colors.shape[0] - 2, colors.shape[1] - 2 * edge
    return colors[1 + down : 1 + down + rows, edge + across : edge + across + columns]
