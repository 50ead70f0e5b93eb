"""Builds interfaces of ROS 2 that the package index does not have, with rosidl: TF, Nav2's action, robrain's service.

`python -m tests.ros2_interfaces.build` builds them once, into a folder of the user's cache: a minute. It needs a C++
compiler, CMake and Ninja. An installed ROS 2 has tf2_msgs and nav2_msgs, and colcon builds examples/robrain_msgs.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).parent
ROBRAIN_MSGS = HERE.parents[1] / "examples" / "robrain_msgs"
GENERATORS = [
    "rclpy[fastrtps]",
    "geometry-msgs",
    *("rosidl-default-generators", "rosidl-core-generators", "rosidl-default-runtime", "python-cmake-module"),
    *("ament-cmake", "ament-cmake-include-directories", "ament-cmake-python", "ament-cmake-ros", "ament-package"),
    *("ament-cmake-gmock", "ament-cmake-gtest", "ament-cmake-pytest", "domain-coordinator", "gmock-vendor"),
    "gtest-vendor",
]
"""Packages ros-jazzy-…; those for tests are asked for by CMake files of the others."""
OTHERS = ["numpy", "catkin_pkg"]
BUILT_WITH = "/opt/python/cp{0}-cp{0}"
"""Where the Python was that the wheels were built with: their CMake files name its headers."""
TOOLS = ("c++", "cmake", "ninja")
PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>For tests</description>
  <maintainer email="maintainers@example.com">the robrain authors</maintainer>
  <license>BSD</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <depend>geometry_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
CMAKE = """cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}} {files} DEPENDENCIES geometry_msgs)
ament_package()
"""


def prefix() -> Path:
    """Where they are, or will be, installed."""
    kinds = (".msg", ".srv", ".action")
    sources = sorted(path for folder in (HERE, ROBRAIN_MSGS) for path in folder.rglob("*.*") if path.suffix in kinds)
    text = b"".join(path.read_bytes() for path in sources)
    version = "{}{}".format(*sys.version_info[:2])
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "robrain" / f"ros2-interfaces-{version}-{hashlib.sha256(text).hexdigest()[:12]}"


def is_built() -> bool:
    """Whether they are there."""
    return (prefix() / "built").is_file()


def variables() -> dict[str, str]:
    """Environment of a process that uses them."""
    python = "python{}.{}".format(*sys.version_info[:2])
    here = {
        "LD_LIBRARY_PATH": prefix() / "lib",
        "PYTHONPATH": prefix() / "lib" / python / "site-packages",
        "AMENT_PREFIX_PATH": prefix(),
    }
    return {name: os.pathsep.join([str(path), *filter(None, [os.environ.get(name)])]) for name, path in here.items()}


def build() -> None:
    """Build them, unless they are there."""
    if is_built():
        return
    if lacking := [tool for tool in TOOLS if shutil.which(tool) is None]:
        sys.exit(f"ros2-interfaces: there is no {', '.join(lacking)} here")
    with TemporaryDirectory() as folder:
        generators = Path(folder) / "generators"
        venv.create(generators, with_pip=True)
        python = generators / "bin" / "python"
        wanted = [*(f"ros-jazzy-{name}" for name in GENERATORS), *OTHERS]
        subprocess.run([python, "-m", "pip", "install", "--quiet", *wanted], check=True)
        _correct_paths(generators)
        for name in ("tf2_msgs", "nav2_msgs"):
            package = Path(folder) / name
            shutil.copytree(HERE / name, package)
            files = " ".join(str(path.relative_to(package)) for path in package.rglob("*.*") if path.is_file())
            (package / "package.xml").write_text(PACKAGE.format(name=name))
            (package / "CMakeLists.txt").write_text(CMAKE.format(name=name, files=files))
            _build_package(package, generators)
        _build_package(ROBRAIN_MSGS, generators)
    (prefix() / "built").touch()


def _correct_paths(generators: Path) -> None:
    built_with = BUILT_WITH.format("{}{}".format(*sys.version_info[:2]))
    python = "python{}.{}".format(*sys.version_info[:2])
    for path in (generators / "share").rglob("*.cmake"):
        text = path.read_text(encoding="utf-8")
        if built_with in text:
            text = text.replace(f"{built_with}/include/{python}", sysconfig.get_paths()["include"])
            path.write_text(text.replace(f"{built_with}/lib", str(generators / "lib")), encoding="utf-8")


def _build_package(package: Path, generators: Path) -> None:
    # By this environment's Python, which finds the libraries of its wheels.
    python = generators / "bin" / "python"
    build = generators / "build" / package.name
    configure = [
        *("cmake", "-S", str(package), "-B", str(build), "-G", "Ninja", f"-DCMAKE_INSTALL_PREFIX={prefix()}"),
        *(f"-DPython3_EXECUTABLE={python}", "-DBUILD_TESTING=OFF", "-Wno-dev"),
    ]
    code = (
        "import subprocess\n"
        f"subprocess.run({configure!r}, check=True, stdout=subprocess.DEVNULL)\n"
        f"subprocess.run(['ninja', '-C', {str(build)!r}, 'install'], check=True, stdout=subprocess.DEVNULL)\n"
    )
    environment = {
        **{name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"},
        "PATH": os.pathsep.join([str(generators / "bin"), os.environ["PATH"]]),
        "AMENT_PREFIX_PATH": str(generators),
        "CMAKE_PREFIX_PATH": str(generators),
        "PYTHONPATH": "",
    }
    subprocess.run([python, "-c", code], check=True, env=environment)


if __name__ == "__main__":
    build()
    sys.stdout.write(f"{prefix()}\n")
