"""Calibration sessions: one session folder each, under one folder, by a name that leads nowhere else."""

import shutil
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel

from hardware.lab.archive import archive
from hardware.lab.database import make_private
from hardware.lab.projects import must_hold, named, within
from hardware.lab.refusal import CONFLICT, NOT_THERE, Refusal
from hardware.places import TURNTABLE
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE

if TYPE_CHECKING:
    from jaxscan.files.session import Session


class Calibration(BaseModel):
    """A calibration session, as the list of them shows.

    Attributes:
        name: of it.
        views: poses of the board that it holds.
        stage_images: photographs of the board on the stage.
        turntable_images: and on the turntable.
        changed_s: when the last was taken, seconds since the epoch.
        problem: why it cannot be read; "" where it can.
    """

    name: str
    views: int
    stage_images: int
    turntable_images: int
    changed_s: float
    problem: str = ""


class Calibrations:
    """The sessions in a folder.

    Args:
        folder: of the lab.
    """

    def __init__(self, folder: Path):
        self._folder = folder / "calibrations"
        make_private(self._folder)

    def new(self, name: str) -> Path:
        """The folder for a session to come.

        Raises:
            Refusal: it is no name, or there is something in it.
        """
        path = named(self._folder, name)
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise Refusal(CONFLICT, f"there is a calibration session {name} already: give it another name")
        return path

    def all(self) -> list[Calibration]:
        """All of them, latest first."""
        found = [self._calibration(path) for path in self._folder.iterdir() if path.is_dir() and any(path.iterdir())]
        return sorted(found, key=lambda one: -one.changed_s)

    def session(self, name: str) -> Path:
        """The folder of one that can be read.

        Raises:
            Refusal: there is none of that name, or it cannot be read.
        """
        path = named(self._folder, name)
        self._session(path)
        return path

    def archive(self, name: str) -> Generator[bytes, None, None]:
        """Its session folder as the bytes of a ZIP file.

        Raises:
            Refusal: there is none of that name, or it cannot be read.
        """
        path = named(self._folder, name)
        # The list before the files: whatever it lists is in the archive.
        file = self._session(path).path
        listed = file.read_bytes()
        return archive(path, {file.name: listed}, self._session(path).photographs())

    def remove(self, name: str) -> None:
        """Remove one, photographs and all.

        Raises:
            Refusal: there is none of that name.
        """
        path = named(self._folder, name)
        if not path.is_dir():
            raise Refusal(NOT_THERE, f"there is no calibration session {name}")
        shutil.rmtree(path)

    @staticmethod
    def _session(path: Path) -> "Session":
        # It waits for JAX, and is not asked for where there is none.
        from jaxscan.files.session import read_session

        if not path.is_dir():
            raise Refusal(NOT_THERE, f"there is no calibration session {path.name}")
        try:
            # Whoever calibrates sees what is cut off; a list must not read every photograph.
            session = read_session(path, whole=False)
        except InputError as error:
            raise Refusal(CONFLICT, within(path, error)) from error
        must_hold(path, session.photographs())
        return session

    def _calibration(self, path: Path) -> Calibration:
        changed_s = path.stat().st_mtime
        try:
            session = self._session(path)
        except Refusal as refusal:
            return Calibration(
                name=path.name, views=0, stage_images=0, turntable_images=0, changed_s=changed_s, problem=str(refusal)
            )
        return Calibration(
            name=path.name,
            views=len(session.views.boards),
            stage_images=session.counts.get(STAGE, 0),
            turntable_images=session.counts.get(TURNTABLE, 0),
            changed_s=changed_s,
        )
