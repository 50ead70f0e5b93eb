"""`robrain machine-files`: writes the files for real machines into a folder, to be copied to their places."""

import shutil
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import SET_UP, CommandApp

FILES = Path(__file__).parent
FOLDERS = ("systemd", "zenohd", "nginx", "udev", "network", "time", "logs", "observability")


def write_files(folder: Path) -> list[Path]:
    """Write the files; returns their paths.

    Raises:
        FileExistsError: the folder exists.
        OSError: it cannot be written.

    """
    folder.mkdir(parents=True)
    for name in FOLDERS:
        shutil.copytree(FILES / name, folder / name)
    return sorted(path for path in folder.rglob("*") if path.is_file())


machine_app = CommandApp(SET_UP)


@machine_app.command()
def machine_files(folder: Annotated[Path, typer.Argument(help="Folder to make.")]) -> None:
    """Write service units, files for router, web server, devices, time, logs and metrics."""
    from robrain.deploy.command_line.terminal import print_line

    for path in write_files(folder):
        print_line(str(path))
