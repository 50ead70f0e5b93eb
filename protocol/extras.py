"""Which extra of the distribution installs a package that the plain install lacks."""

from typing import NamedTuple

PACKAGES = {
    "navigation": "numpy scipy numba dateutil",
    "bringup": "tomlkit",
    "sim": "pymunk PIL yaml tomli_w",
    "team": "mcap mcap_protobuf foxglove_schemas_protobuf google zstandard viser jinja2 websockets pyvrp",
    "report": "matplotlib pandas",
    "parquet": "pyarrow",
    "metrics": "prometheus_client",
    "vda5050": "paho",
    "sweep": "dask distributed",
    "foxglove": "foxglove",
    "ros2-native": "rosbags xxhash",
    "security": "cryptography",
    "mcp": "anyio mcp mcp_types uvicorn",
    "ros2": "rclpy geometry_msgs nav_msgs sensor_msgs std_msgs std_srvs",
    "hardware": "smbus2 gpiod",
    "doors": "pymodbus",
    "bench": "ortools vrplib",
}
"""Import names by extra."""
EXTRAS = {package: extra for extra, packages in PACKAGES.items() for package in packages.split()}
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
