"""The folder in which robrain stores a user's lasting data, by the XDG base directory specification."""

import os
from pathlib import Path

from robrain.protocol.errors import RobrainError


def state_folder() -> Path:
    """Path of the folder, which may not exist yet (RobrainError if the user has no home folder)."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if state.is_absolute():
        return state / "robrain"
    try:
        home = Path.home()
    except RuntimeError:
        home = Path()
    if not home.is_absolute():
        raise RobrainError("this user has no home folder: set HOME or XDG_STATE_HOME to a folder that can be written")
    return home / ".local" / "state" / "robrain"
