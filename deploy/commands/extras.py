"""What a command says when a package is missing that the plain install lacks."""

from robrain.deploy.errors import UsageError
from robrain.protocol.extras import missing_package


def missing_extra(error: ModuleNotFoundError) -> UsageError | None:
    """An error that says what to install after a failed import; None if no extra contains the package.

    >>> str(missing_extra(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer")))
    "mcap is not installed: pip install 'robrain[team]'"
    """
    missing = missing_package(error)
    if missing is None or not missing.extra:
        return None
    return UsageError(f"{missing.package} is not installed: pip install '{missing.needed}'")
