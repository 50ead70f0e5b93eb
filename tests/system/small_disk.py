"""A file system of a few megabytes for one process, which a test fills; needs unshare(1) and user namespaces."""

import shlex
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

IN_A_SMALL_ROOM = """
mount -t tmpfs -o size={size} tmpfs {disk} || exit 77
{command} &
process=$!
trap 'kill -INT $process' TERM
while kill -0 $process 2>/dev/null; do wait $process; done
cp -r {disk} {kept}
"""
"""The file system is the script's own: its files are copied out before it is gone."""


def can_have_small_disks() -> bool:
    """Whether a process may mount a file system of its own here."""
    unshare = shutil.which("unshare")
    return (
        unshare is not None
        and not subprocess.run([unshare, "-Urm", "true"], capture_output=True, check=False).returncode
    )


class SmallDisk:
    """Runs a command whose files are on a file system of its own.

    Args:
        disk: folder to make; the command's files are to be in it.
        command: the program and its arguments.
        size: as for `mount -o size=`.

    """

    def __init__(self, disk: Path, command: Sequence[str], size: str = "16m") -> None:
        disk.mkdir()
        self.kept = disk.with_name(f"{disk.name}.kept")
        """The files, once the command has ended."""
        script = IN_A_SMALL_ROOM.format(
            size=size, disk=shlex.quote(str(disk)), kept=shlex.quote(str(self.kept)), command=shlex.join(command)
        )
        self.process = subprocess.Popen(
            ["unshare", "-Urm", "bash", "-c", script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._disk = disk

    @property
    def folder(self) -> Path:
        """The files while the command runs."""
        return Path(f"/proc/{self.process.pid}/root") / self._disk.relative_to("/")

    @contextmanager
    def full(self) -> Iterator[None]:
        """Without any free space for as long as the block lasts."""
        ballast = self.folder / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as stream:
            while True:
                stream.write(bytes(4096))
        yield
        ballast.unlink()
