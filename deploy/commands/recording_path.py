"""Where a command records to."""

from pathlib import Path

from robrain.deploy.errors import UsageError


def new_recording(path: Path | None) -> Path | None:
    """A path to record to, which must not exist yet: a recording is never overwritten (UsageError)."""
    if path is not None and path.exists():
        raise UsageError(f"--record {path}: it exists already; give another name or move it away")
    return path


def next_recording(folder: Path, name: str) -> Path:
    """`folder/name-N.mcap` with the first free number; creates the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    number = 1
    while (path := folder / f"{name}-{number}.mcap").exists():
        number += 1
    return path
