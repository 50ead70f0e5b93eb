"""What a command says when a package is missing that the plain install lacks."""

from collections.abc import Sequence

from robrain.deploy.errors import UsageError
from robrain.protocol.extras import missing_package

OF_COMMANDS = {
    **dict.fromkeys(("run", "demo", "up", "arena", "scenarios", "bench", "soak"), "sim"),
    **dict.fromkeys(("dashboard", "replay", "record", "info", "check", "diff", "recover", "export"), "team"),
    "bringup": "bringup",
    "report": "report",
    "sweep": "sweep",
    "fork": "sim,team",
    "foxglove": "foxglove",
    "assistant": "mcp",
    "ros2": "team,ros2-native,ros2",
    "bench allocation": "team",
    "bench consensus": "team",
    "bench log": "navigation",
}
"""Extra with all that a command needs, navigation included."""


def missing_extra(error: ModuleNotFoundError, words: Sequence[str]) -> UsageError | None:
    """An error that says what to install after a failed import; None if no extra contains the package.

    A command that lacks arrays mostly lacks more, and names the extra that has everything.

    Args:
        error: of the import.
        words: the command line.

    >>> str(missing_extra(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer"), ["record"]))
    "mcap is not installed: pip install 'robrain[team]'"
    >>> str(missing_extra(ModuleNotFoundError("No module named 'numpy'", name="numpy"), ["run", "depot"]))
    "numpy is not installed: pip install 'robrain[sim]'"
    """
    missing = missing_package(error)
    if missing is None or not missing.extra:
        return None
    if missing.extra in ("navigation", "team") and words:
        known = OF_COMMANDS.get(" ".join(words[:2])) or OF_COMMANDS.get(words[0], missing.extra)
        missing = missing._replace(extra=known)
    return UsageError(f"{missing.package} is not installed: pip install '{missing.needed}'")
