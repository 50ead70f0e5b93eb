"""The command that runs this installation of robrain, for hints."""

import os
import shlex
import shutil
import sys
from pathlib import Path

NAME = "robrain"


def own_program() -> str:
    """The shell command, for the current folder, that runs this installation of robrain.

    `robrain` if the shell's path finds this installation; else the path of the script beside this Python, relative if
    it is below this folder; else Python with the module.
    """
    script = Path(sys.executable).with_name(NAME)
    found = shutil.which(NAME)
    if found is not None and (not script.exists() or os.path.samefile(found, script)):
        return NAME
    if not os.access(script, os.X_OK):
        return f"{shlex.quote(sys.executable)} -m {NAME}.cli"
    try:
        return shlex.quote(str(script.relative_to(Path.cwd())))
    except (ValueError, OSError):  # not below this folder, or this folder is gone
        return shlex.quote(str(script))
