"""Which extra brings a package that the plain install does not have."""

from robrain.deploy.errors import UsageError

EXTRAS = {
    "pymunk": "sim",
    "PIL": "sim",
    "yaml": "sim",
    "tomli_w": "sim",
    "mcap": "team",
    "mcap_protobuf": "team",
    "foxglove_schemas_protobuf": "team",
    "google": "team",
    "zstandard": "team",
    "viser": "team",
    "websockets": "team",
    "pyvrp": "team",
    "matplotlib": "report",
    "pandas": "report",
    "pyarrow": "parquet",
    "foxglove": "foxglove",
    "ortools": "bench",
    "vrplib": "bench",
}
"""By the name that is imported."""


def missing_package(error: ModuleNotFoundError) -> UsageError | None:
    """What to install for an import that failed, in one sentence; None if no extra brings it.

    >>> str(missing_package(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer")))
    "mcap is not installed: pip install 'robrain[team]'"
    """
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    return UsageError(f"{package} is not installed: pip install 'robrain[{EXTRAS[package]}]'")
