"""Which extra installs a package that the plain install lacks."""

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
    "dask": "sweep",
    "distributed": "sweep",
    "foxglove": "foxglove",
    "ortools": "bench",
    "vrplib": "bench",
}
"""Extra by import name."""


def missing_package(error: ModuleNotFoundError) -> UsageError | None:
    """An error that says what to install after a failed import; None if no extra contains the package.

    >>> str(missing_package(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer")))
    "mcap is not installed: pip install 'robrain[team]'"
    """
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    return UsageError(f"{package} is not installed: pip install 'robrain[{EXTRAS[package]}]'")
