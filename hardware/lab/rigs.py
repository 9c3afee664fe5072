"""Rigs of a lab: calibrated from its sessions, and which of them is in use."""

import contextlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pydantic import BaseModel, Field

from hardware.lab.database import make_private
from hardware.lab.projects import named, within
from hardware.lab.reconstructor import Reconstructor
from hardware.lab.refusal import CONFLICT, NOT_THERE, Refusal
from jaxscan.atomic import replacing
from jaxscan.errors import InputError, JaxscanError

if TYPE_CHECKING:
    from jaxscan import RigFile

# Which rig is in use, for the next server: no rig is called so.
_CHOSEN: Final = "in use"
_VERDICT: Final = ".verdict.json"


class CalibratedRig(BaseModel):
    """A rig that can be taken into use.

    Attributes:
        name: of the calibration session that it comes from; "" for that which the server was started with.
        in_use: whether points are made with it.
        made_s: when it was calibrated, seconds since the epoch; 0 for that which the server was started with.
        verdict: how good it is, what limits it, what to photograph next, and warnings, a line each.
    """

    name: str
    in_use: bool
    made_s: float
    verdict: list[str] = Field(default_factory=list)


class Rigs:
    """The rigs in a folder.

    Args:
        folder: of the lab.
        given: the rig that the server was started with; without one the rig that was in use before is.
        used: called with the rig that is in use, whenever that changes; None for none.
    """

    def __init__(self, folder: Path, given: "RigFile | None", used: "Callable[[RigFile | None], object]"):
        self._folder, self._given, self._used = folder / "rigs", given, used
        self._mutex, self._solver = threading.Lock(), Reconstructor()
        make_private(self._folder)
        self.name = ""
        self.current = given
        if given is None:
            # One that cannot be read any more is said where it is chosen.
            with contextlib.suppress(Refusal, OSError):
                self.name = (self._folder / _CHOSEN).read_text()
                self.current = self._read(self.name) if self.name else None
        if self.current is None:
            self.name = ""

    def all(self) -> list[CalibratedRig]:
        """All of them, latest first; that which the server was started with at the end."""
        found = []
        for path in self._folder.glob("*.json"):
            if not path.name.endswith(_VERDICT):
                said = path.with_name(path.stem + _VERDICT)
                verdict = json.loads(said.read_text()) if said.exists() else []
                one = CalibratedRig(
                    name=path.stem, in_use=path.stem == self.name, made_s=path.stat().st_mtime, verdict=verdict
                )
                found.append(one)
        found.sort(key=lambda rig: -rig.made_s)
        if self._given is not None:
            found.append(CalibratedRig(name="", in_use=self.name == "", made_s=0.0))
        return found

    def calibrate(self, name: str, session: Path) -> CalibratedRig:
        """The rig of a calibration session, solved in a process of its own; it is not in use by that.

        Raises:
            Refusal: the session cannot be solved.
        """
        path = named(self._folder, name).with_name(f"{name}.json")
        try:
            verdict = self._solver.calibrate(session, path)
        except JaxscanError as error:
            raise Refusal(CONFLICT, within(session, error)) from error
        with replacing(path.with_name(name + _VERDICT), "w") as file:
            file.write(json.dumps(verdict))
        if name == self.name:
            # What is in use is the rig of that name.
            self.use(name)
        return next(rig for rig in self.all() if rig.name == name)

    def use(self, name: str) -> None:
        """Take one into use: by its name, or "" for that which the server was started with, or none.

        Raises:
            Refusal: there is none of that name, or it cannot be read.
        """
        with self._mutex:
            rig = self._read(name) if name else self._given
            with replacing(self._folder / _CHOSEN, "w") as file:
                file.write(name)
            self.name, self.current = name, rig
            self._used(rig)

    def close(self) -> None:
        """Solve nothing more."""
        self._solver.close()

    def _read(self, name: str) -> "RigFile":
        from jaxscan import read_rig

        path = named(self._folder, name).with_name(f"{name}.json")
        if not path.is_file():
            raise Refusal(NOT_THERE, f"there is no rig {name}: calibrate the session of that name")
        try:
            return read_rig(path)
        except InputError as error:
            raise Refusal(CONFLICT, within(path, error)) from error
