"""Stripes of a light that moves: of each board several photographs, with the light at several positions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from jaxscan.files.axes import read_axis_name
from jaxscan.files.listing import files_or_gaps
from jaxscan.files.settings import relative_name
from jaxscan.files.table import Table
from jaxscan.rig import LIGHTS
from jaxscan.rig.light import moves

STEPS = "stripe_steps"
# What moves a light, where nothing else is said.
AXIS = "sweep"

# Of one board: the motor steps of the light's axis, and the photograph.
Sweep = tuple[tuple[int, Path], ...]


def read_light_axis(laser: Table, sheet: str) -> str:
    """What moves a laser's light, by its name; "" where nothing does.

    Raises:
        InputError: it is no name, or the light stands still.
    """
    if not moves(LIGHTS[sheet]):
        if "axis" in laser:
            raise laser.error("axis", f'a sheet that is "{sheet}" stands still: leave axis out, or set sheet = "swept"')
        return ""
    return read_axis_name(laser, AXIS)


def read_sweeps(table: Table, boards: Sequence[Path], axis: str) -> tuple[Sweep, ...]:
    """The stripes of each board, from the keys `stripes` and `stripe_steps` of a table.

    Where there is no `stripes`, each photograph of a board shows one stripe itself.

    Raises:
        InputError: their numbers do not go together.
    """
    if STEPS not in table:
        raise table.error(
            STEPS,
            f"is missing: the light is moved by the {axis}, so give its motor steps in the photographs of the stripes, "
            "those of one board where all boards have the same",
        )
    if not boards:
        raise table.error(STEPS, "there is no photograph of a board under [views]: name them as boards")
    paths = files_or_gaps(table, "stripes") if "stripes" in table else tuple(boards)
    each, left = divmod(len(paths), len(boards))
    if left or not each:
        raise table.error(
            "stripes",
            f"{len(paths)} photographs of the stripe for {len(boards)} of the board: give as many for each board, all "
            'those of the first board before those of the second, with "" where there is none',
        )
    steps = table.wholes(STEPS)
    if len(steps) not in (each, len(paths)):
        raise table.error(
            STEPS, f"{len(steps)} positions for {each} stripes on each board: give {each}, or {len(paths)} for all"
        )
    steps = steps if len(steps) == len(paths) else steps * len(boards)
    pairs = list(zip(steps, paths, strict=True))
    sweeps = tuple(
        tuple((step, path) for step, path in pairs[i * each : (i + 1) * each] if path is not None)
        for i in range(len(boards))
    )
    for board, sweep in zip(boards, sweeps, strict=True):
        step, count = Counter(step for step, _ in sweep).most_common(1)[0] if sweep else (0, 0)
        if count > 1:
            raise table.error(
                STEPS,
                f"{count} stripes on {board.name} are at step {step}: give each the position at which it was "
                'photographed, and where it was photographed twice "" in stripes for one of them',
            )
    return sweeps


def sweeps_values(sweeps: Sequence[Sweep], folder: Path) -> Mapping[str, Any]:
    """The inverse of `read_sweeps`; a board with fewer stripes than another has gaps."""
    most = max(map(len, sweeps), default=0)
    names = [[relative_name(path, folder) for _, path in each] + [""] * (most - len(each)) for each in sweeps]
    steps = [[step for step, _ in each] + [0] * (most - len(each)) for each in sweeps]
    return {"stripes": list(chain(*names)), STEPS: list(chain(*steps))}
