"""Where numba stores compiled kernels; chosen before it is loaded."""

import logging
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"

logger = logging.getLogger(__name__)


def choose_kernel_cache() -> None:
    """Choose the first folder that can be written: the variable's, the install, the user's cache, the temporary folder.

    Without any, kernels are compiled in memory by each process, and a warning is logged.
    """
    if VARIABLE in os.environ or os.access(Path(__file__).parent, os.W_OK):
        return
    with suppress(OSError):
        os.environ[VARIABLE] = str(_users_cache() or _temporary_cache())
        return
    with suppress(ModuleNotFoundError):
        from numba.core.dispatcher import Dispatcher

        Dispatcher.enable_caching = lambda self: None  # type: ignore[method-assign]
        logger.warning(
            "no folder for compiled kernels can be written, so each process compiles them, which takes half a minute; "
            "set %s to a folder",
            VARIABLE,
        )


def _users_cache() -> Path | None:
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME", "")) / ".cache")
    if not base.is_absolute():
        return None
    folder = base / "robrain"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    return folder


def _temporary_cache() -> Path:
    """A folder of this user alone, since cached kernels are executed."""
    folder = Path(tempfile.gettempdir()) / f"robrain-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise PermissionError(f"{folder} belongs to somebody else")
    return folder
