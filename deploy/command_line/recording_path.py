"""Files in which a run is kept: its recording, its journal."""

import re
from pathlib import Path

from robrain.deploy.errors import UsageError


def new_recording(path: Path | None) -> Path | None:
    """A path to record to, which must not exist yet: a recording is never overwritten (UsageError)."""
    if path is not None and path.exists():
        raise UsageError(f"--record {path}: it exists already; give another name or move it away")
    return path


def make_folder(folder: Path) -> None:
    """Make a folder for what a command writes, unless it exists (UsageError if it cannot be made)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"{folder.absolute()} cannot be made: {error.strerror}; run robrain in another folder"
        ) from error


def next_file(folder: Path, name: str, suffix: str = ".mcap") -> Path:
    """`folder/name-N.mcap` with the number after the highest there is; creates the folder.

    Parts of split recordings count, also those whose first part was removed. UsageError if the folder cannot be made.
    """
    make_folder(folder)
    numbered = re.compile(rf"{re.escape(name)}-(\d+)(_\w+)?{re.escape(suffix)}.*")
    found = [numbered.fullmatch(path.name) for path in folder.iterdir()]
    return folder / f"{name}-{1 + max((int(match[1]) for match in found if match), default=0)}{suffix}"
