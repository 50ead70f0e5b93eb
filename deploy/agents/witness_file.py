"""Where a live robot stores what it has answered as a witness: a small file that survives a power cut."""

import os
from pathlib import Path

import msgspec

from robrain.agent.witness import Kept
from robrain.protocol.state_folder import state_folder

STATE_VARIABLE = "STATE_DIRECTORY"
"""Set by systemd for a unit with `StateDirectory=`; several folders are separated by colons."""


def witness_path(team: str, robot: str) -> Path:
    """The file of a robot: in the unit's state folder, else in the user's."""
    folder = os.environ.get(STATE_VARIABLE, "").partition(":")[0]
    return (Path(folder) if folder else state_folder()) / f"witness-{team}-{robot}.json"


class WitnessFile:
    """Stores it in a file, which is replaced as a whole.

    Args:
        path: of the file; made, with its folder, by the first answer.

    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> Kept:
        """What was stored last; nothing if there is no file (OSError, ValueError)."""
        try:
            data = self._path.read_bytes()
        except FileNotFoundError:
            return Kept()
        try:
            return msgspec.json.decode(data, type=Kept)
        except msgspec.MsgspecError as error:
            raise ValueError(f"{self._path}: {error}; if no coordinator was ever elected, remove it") from error

    def write(self, kept: Kept) -> None:
        """Replace the file, on the disk when this returns (OSError)."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = self._path.with_name(f"{self._path.name}.new")
        with new.open("wb") as file:
            file.write(msgspec.json.encode(kept))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)
        descriptor = os.open(self._path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
