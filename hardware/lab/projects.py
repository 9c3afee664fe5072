"""Projects: one scan folder each, under one folder, by a name that leads nowhere else."""

import hashlib
import re
import shutil
import tempfile
import threading
from collections.abc import Generator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel

from hardware.lab.archive import archive
from hardware.lab.database import make_private
from hardware.lab.measuring import Clicks, Found
from hardware.lab.orders import PROJECT
from hardware.lab.reconstructor import Reconstructor
from hardware.lab.refusal import CONFLICT, NOT_THERE, Refusal
from hardware.scan_plan import PLAN_FILE, Plan, ScanFolder, holds_something
from jaxscan.errors import InputError, JaxscanError
from jaxscan.files.scan import SCAN_FILE, Scan, read_listed

if TYPE_CHECKING:
    from jaxscan import RigFile


class Project(BaseModel):
    """A project, as the list of them shows.

    Attributes:
        name: of it.
        frames: photographs that it holds.
        changed_s: when the last was taken, seconds since the epoch.
        problem: why it cannot be read; "" where it can.
    """

    name: str
    frames: int
    changed_s: float
    problem: str = ""


class Projects:
    """The projects in a folder.

    Args:
        folder: of the lab.
        rig: of the scanner, for points.
    """

    def __init__(self, folder: Path, rig: "RigFile | None" = None):
        self._home, self._folder, self._clouds = folder, folder / "projects", folder / "clouds"
        self._rig_text = "" if rig is None else _text(rig)
        self._reconstructing, self._reconstructor = threading.Lock(), Reconstructor()
        for made in (self._folder, self._clouds):
            make_private(made)

    def use(self, rig: "RigFile | None") -> None:
        """Make points with another rig, or none, from now on."""
        self._rig_text = "" if rig is None else _text(rig)

    def path(self, name: str) -> Path:
        """The folder of a project, there or not.

        Raises:
            Refusal: it is no name.
        """
        return named(self._folder, name)

    def all(self) -> list[Project]:
        """All of them, latest first."""
        found = [self._project(path) for path in self._folder.iterdir() if (path / SCAN_FILE).is_file()]
        return sorted(found, key=lambda project: -project.changed_s)

    def one(self, name: str) -> Project:
        """One of them.

        Raises:
            Refusal: there is none of that name.
        """
        self.scan(name)
        return self._project(self.path(name))

    def scan(self, name: str) -> Scan:
        """Its scan.

        Raises:
            Refusal: there is none of that name, or it cannot be read.
        """
        path = self.path(name)
        if not (path / SCAN_FILE).is_file():
            raise Refusal(NOT_THERE, f"there is no project {name}")
        try:
            scan = read_listed(path)
        except InputError as error:
            raise Refusal(CONFLICT, within(path, error)) from error
        must_hold(path, [*scan.frames, *scan.backgrounds])
        return scan

    def frame(self, name: str, number: int) -> Path:
        """The file of one photograph, counted from 0.

        Raises:
            Refusal: there is none.
        """
        frames = self.scan(name).frames
        if not 0 <= number < len(frames):
            raise Refusal(NOT_THERE, f"project {name} has no photograph {number}")
        return frames[number]

    def archive(self, name: str) -> Generator[bytes, None, None]:
        """Its scan folder as the bytes of a ZIP file; what has been taken until now, where it is under way.

        Raises:
            Refusal: there is none of that name.
        """
        path = self.path(name)
        # The list before the files: whatever it lists is in the archive.
        self.scan(name)
        listed = (path / SCAN_FILE).read_bytes()
        scan = self.scan(name)
        plan = [path / PLAN_FILE] if (path / PLAN_FILE).is_file() else []
        return archive(path, {SCAN_FILE: listed}, [*plan, *scan.frames, *scan.backgrounds])

    def begin(self, name: str, plan: Plan) -> ScanFolder:
        """A project for a scan; what this beginning leaves is cleared away if it is cut off.

        Raises:
            InputError: there is something in it, or the disk.
        """
        path = self.path(name)
        try:
            return ScanFolder.create(path, plan)
        except (JaxscanError, OSError):
            if path.is_dir() and not holds_something(path):
                shutil.rmtree(path, ignore_errors=True)
            raise

    def cloud_file(self, name: str) -> Path:
        """Where the PLY file of its points is, or will be: one of this rig, these photographs, and this program.

        Raises:
            Refusal: no rig is in use, or there is no project.
        """
        return self._made_file(name, self._rig_text, ".ply")

    def _made_file(self, name: str, rig: str, ending: str) -> Path:
        scan = self.scan(name)
        if not rig:
            raise Refusal(
                CONFLICT,
                "no rig is in use: calibrate a session and take its rig into use, or scanner serve --rig rig.json",
            )
        # A rig as its file has it, and the program that reconstructs.
        made_of = hashlib.sha256((rig + version("jaxscan")).encode())
        for file in (scan.path, *scan.frames, *scan.backgrounds):
            found = file.stat()
            made_of.update(f"{file.name} {found.st_size} {found.st_mtime_ns}\n".encode())
        made_of.update(scan.path.read_bytes())
        return self._clouds / f"{name}.{made_of.hexdigest()[:32]}{ending}"

    def cloud(self, name: str) -> Path:
        """A PLY file of its points, reconstructed where it is not there yet.

        Raises:
            Refusal: as `cloud_file`, or there is nothing in the project.
        """
        return self._made(name, self._rig_text, ".ply")

    def drawn(self, name: str) -> Path:
        """A file of some of its points, for a page to draw: x, y, z, float32, little endian, mm.

        Raises:
            Refusal: as `cloud`.
        """
        return self._made(name, self._rig_text, ".npz").with_suffix(".points")

    def measured(self, name: str, clicks: Clicks) -> Found:
        """Faces that were clicked on these points.

        Raises:
            Refusal: as `cloud`, or the clicks are none.
        """
        rig = self._rig_text
        image = self._made(name, rig, ".npz")
        try:
            return self._reconstructor.measure(rig, image, name, clicks)
        except JaxscanError as error:
            raise Refusal(CONFLICT, within(image, error)) from error

    def _made(self, name: str, rig: str, ending: str) -> Path:
        path = self._made_file(name, rig, ending)
        with self._reconstructing:
            if not path.exists():
                try:
                    self._reconstructor.make(rig, self.path(name), path)
                except JaxscanError as error:
                    raise Refusal(CONFLICT, within(self.path(name), error)) from error
                self._forget_clouds(name, path.stem)
        return path

    def close(self) -> None:
        """Make no more points."""
        self._reconstructor.close()

    def remove(self, name: str) -> None:
        """Remove one, photographs and all.

        Raises:
            Refusal: there is none of that name.
        """
        path = self.path(name)
        if not path.is_dir():
            raise Refusal(NOT_THERE, f"there is no project {name}")
        shutil.rmtree(path)
        self._forget_clouds(name)

    def without_place(self, words: str) -> str:
        """A text without the place of the lab on its machine."""
        return words.replace(f"{self._home}/", "")

    def _forget_clouds(self, name: str, but: str | None = None) -> None:
        for old in self._clouds.glob(f"{name}.*"):
            if old.stem != but:
                old.unlink(missing_ok=True)

    @staticmethod
    def _project(path: Path) -> Project:
        changed_s = (path / SCAN_FILE).stat().st_mtime
        try:
            return Project(name=path.name, frames=len(read_listed(path).frames), changed_s=changed_s)
        except InputError as error:
            return Project(name=path.name, frames=0, changed_s=changed_s, problem=within(path, error))


def _text(rig: "RigFile") -> str:
    """A rig as its file has it."""
    from jaxscan import write_rig

    with tempfile.TemporaryDirectory() as folder:
        write_rig(Path(folder) / "rig.json", rig)
        return (Path(folder) / "rig.json").read_text()


def named(parent: Path, name: str) -> Path:
    """The folder of that name in another, there or not.

    Raises:
        Refusal: it is no name.
    """
    if not re.fullmatch(PROJECT, name):
        raise Refusal(NOT_THERE, "a name has letters, digits, _ and - alone")
    return parent / name


def must_hold(folder: Path, files: Sequence[Path]) -> None:
    """See that what a folder lists lies in it: nothing else is handed out.

    Raises:
        Refusal: it does not.
    """
    home = folder.resolve()
    for file in files:
        if not file.resolve().is_relative_to(home):
            raise Refusal(CONFLICT, f"{folder.name} lists {file.name}, which lies outside of it: copy it there")


def within(folder: Path, error: Exception) -> str:
    """An error's text without the place of the lab on its machine."""
    return str(error).replace(f"{folder.parent}/", "")
