"""The kinds of stage drivers by their names in `scanner.toml`: each driver's file registers its own."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from hardware.protocols import StageDriver

Setting = type[str] | type[int] | type[float] | type[bool]


@dataclass(frozen=True)
class StageKind:
    """How stages of a kind are made.

    Attributes:
        make: the driver's class, or a function: called with `travel` and the settings, by their names. A parameter
            `homed` takes whether the controller has kept its count, `beside` the driver of an axis that is opened
            already and shares the port.
        settings: what its table in `scanner.toml` may hold, with the type of each. What `make` has a default for may be
            left out.
    """

    make: Callable[..., StageDriver]
    settings: Mapping[str, Setting]

    def takes(self, parameter: str) -> bool:
        """Whether `make` has a parameter of that name."""
        return parameter in inspect.signature(self.make).parameters

    def needs(self, setting: str) -> bool:
        """Whether a setting may not be left out."""
        parameter = inspect.signature(self.make).parameters.get(setting)
        return parameter is not None and parameter.default is inspect.Parameter.empty


STAGE_KINDS: Final[dict[str, StageKind]] = {}


def register_stage(kind: str, make: Callable[..., StageDriver], **settings: Setting) -> None:
    """Make a kind of stage known by its name in `scanner.toml`; see `StageKind`."""
    STAGE_KINDS[kind] = StageKind(make, settings)
