"""Which extra of the distribution installs a package that the plain install lacks."""

from typing import NamedTuple

EXTRAS = {
    "numpy": "navigation",
    "scipy": "navigation",
    "numba": "navigation",
    "tomlkit": "bringup",
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
    "jinja2": "team",
    "websockets": "team",
    "pyvrp": "team",
    "matplotlib": "report",
    "pandas": "report",
    "pyarrow": "parquet",
    "prometheus_client": "metrics",
    "dask": "sweep",
    "distributed": "sweep",
    "foxglove": "foxglove",
    "rosbags": "ros2-native",
    "xxhash": "ros2-native",
    "cryptography": "security",
    "anyio": "mcp",
    "mcp": "mcp",
    "mcp_types": "mcp",
    "uvicorn": "mcp",
    "rclpy": "ros2",
    "geometry_msgs": "ros2",
    "nav_msgs": "ros2",
    "sensor_msgs": "ros2",
    "std_msgs": "ros2",
    "std_srvs": "ros2",
    "smbus2": "hardware",
    "gpiod": "hardware",
    "ortools": "bench",
    "vrplib": "bench",
}
"""Extra by import name."""


class MissingPackage(NamedTuple):
    """A package that is not installed."""

    package: str
    """Its import name."""
    extra: str
    """The extra that installs it; empty if none does."""

    @property
    def needed(self) -> str:
        """Package to install.

        >>> MissingPackage("numba", "navigation").needed
        'robrain[navigation]'
        """
        return f"robrain[{self.extra}]" if self.extra else self.package


def missing_package(error: ImportError) -> MissingPackage | None:
    """The package that a failed import lacks; None if it failed for another reason.

    >>> missing_package(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap.writer"))
    MissingPackage(package='mcap', extra='team')
    >>> missing_package(ModuleNotFoundError("No module named 'robrain.pluggins'", name="robrain.pluggins")) is None
    True
    """
    package = (error.name or "").partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or package in ("", "robrain"):
        return None
    return MissingPackage(package, EXTRAS.get(package, ""))
