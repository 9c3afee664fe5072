"""Photographs that several sessions list: each counts once, or σ would be too small."""

import hashlib
import os
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from jaxscan.errors import InputError
from jaxscan.files.listing import name_some
from jaxscan.files.session import Session, Views
from jaxscan.files.session_axes import StageImages, TurntableImages
from jaxscan.phrases import stripe_of

_BOARD: Final = "a photograph of the board"
_Sequence = TypeVar("_Sequence", bound=StageImages)


def listed_once(sessions: Sequence[Session]) -> tuple[list[Session], list[str]]:
    """The sessions with each photograph in the first of those that list it alone, and a note on each that several do.

    A photograph is known by its file, and a copy by its bytes. Two sequences on stage or turntable that share a
    photograph are of one board that stood in one place: they become one sequence, in the first session. A session all
    of whose photographs are listed before is left with none.

    Args:
        sessions: of one board and the same lasers.

    Raises:
        InputError: one is a photograph of the board here and of the stage there, or at another step count, or it is
            paired with different photographs of the stripe.
    """
    files = _files(sessions)
    kept: list[Session] = []
    notes = []
    for session in sessions:
        rest = session
        for i, earlier in enumerate(kept):
            again = _listed_by_both(earlier, rest, files)
            if again:
                kept[i], rest = _apart(earlier, rest, files)
                are = "photograph counts" if len(again) == 1 else "photographs count"
                notes.append(
                    f"{len(again)} {are} once, listed by {earlier.path} and by {session.path}: {name_some(again)}"
                )
        kept.append(rest)
    return kept, notes


def _files(sessions: Sequence[Session]) -> dict[Path, str]:
    """Which file each photograph is; of files that hold the same bytes, the first."""
    real = {path: os.path.realpath(path) for session in sessions for path in session.photographs()}
    sizes = {file: os.path.getsize(file) for file in real.values()}
    common = Counter(sizes.values())
    first: dict[bytes, str] = {}

    def original(file: str) -> str:
        if common[sizes[file]] == 1:
            return file
        with open(file, "rb") as opened:
            return first.setdefault(hashlib.file_digest(opened, "sha256").digest(), file)

    originals = {file: original(file) for file in sizes}
    return {path: originals[file] for path, file in real.items()}


def _roles(session: Session, files: Mapping[Path, str]) -> dict[str, set[str]]:
    """What each file is a photograph of, in words."""
    roles = defaultdict(set)
    own = session.views.stripes
    for i, board in enumerate(session.views.boards):
        roles[files[board]].add(f"{_BOARD}, with the stripe in it" if own is None and session.lasers else _BOARD)
        for laser, sweeps in session.views.sweeps.items():
            for step, stripe in sweeps[i]:
                roles[files[stripe]].add(f"the {stripe_of(laser)} at step {step} in the pose of {files[board]}")
        for laser, paths in (own or {}).items():
            if (stripe := paths[i]) is not None:
                roles[files[stripe]].add(f"the {stripe_of(laser)} in the pose of {files[board]}")
    for sequence in session.sequences.values():
        for path, step in zip(sequence.images, sequence.steps, strict=True):
            turned = isinstance(sequence, TurntableImages)
            where = f"the turntable, with the stage at {sequence.stage_step}" if turned else "the stage"
            roles[files[path]].add(f"an image at step {step} of {where}")
    return roles


def _listed_by_both(first: Session, second: Session, files: Mapping[Path, str]) -> list[Path]:
    """The photographs of the second that the first lists too, in the same role."""
    roles, others = _roles(first, files), _roles(second, files)
    again = {files[path]: path for path in second.photographs() if files[path] in roles}
    for file, path in again.items():
        here, there = roles[file], others[file]
        if not (here <= there or there <= here):
            raise InputError(
                f"{path}: is {_in_words(here)} in {first.path}, and {_in_words(there)} in {second.path}: correct the "
                "one that is wrong, or name the photograph in one of them alone"
            )
    return list(again.values())


def _in_words(roles: set[str]) -> str:
    return " and ".join(sorted(roles))


def _apart(first: Session, second: Session, files: Mapping[Path, str]) -> tuple[Session, Session]:
    """Both, with what both list in the first alone."""
    stage, other_stage = _one_sequence(first.stage, second.stage, files)
    turntable, other_turntable = _one_sequence(first.turntable, second.turntable, files)
    views, others = _views_apart(first, second, files)
    return (
        replace(first, views=views, stage=stage, turntable=turntable),
        replace(second, views=others, stage=other_stage, turntable=other_turntable),
    )


def _one_sequence(
    first: _Sequence | None, second: _Sequence | None, files: Mapping[Path, str]
) -> tuple[_Sequence | None, _Sequence | None]:
    """Two sequences; joined at the position of the first where they share a photograph."""
    if first is None or second is None:
        return first, second
    known = {files[path] for path in first.images}
    more = [i for i, path in enumerate(second.images) if files[path] not in known]
    if len(more) == len(second.images):
        return first, second
    both = sorted(
        [*((first, i) for i in range(len(first.images))), *((second, i) for i in more)],
        key=lambda each: (each[0].steps[each[1]], each[0].images[each[1]]),
    )
    lasers = dict.fromkeys([*first.stripes, *second.stripes])
    stripes = {
        laser: tuple(own.stripes[laser][i] if laser in own.stripes else None for own, i in both) for laser in lasers
    }
    images, steps = tuple(own.images[i] for own, i in both), tuple(own.steps[i] for own, i in both)
    return replace(first, images=images, steps=steps, stripes=stripes), None


def _views_apart(first: Session, second: Session, files: Mapping[Path, str]) -> tuple[Views, Views]:
    """The views of both; of a board in both the first has the stripe, though only the second may list it."""
    at = {files[board]: i for i, board in enumerate(first.views.boards)}
    rest = [j for j, board in enumerate(second.views.boards) if files[board] not in at]
    again = [(at[files[board]], j) for j, board in enumerate(second.views.boards) if files[board] in at]

    def left(paths: Sequence[Path | None]) -> tuple[Path | None, ...]:
        return tuple(paths[j] for j in rest)

    boards = tuple(second.views.boards[j] for j in rest)
    swept = {laser: list(own) for laser, own in first.views.sweeps.items()}
    for laser, own in second.views.sweeps.items():
        for i, j in again:
            # A photograph that both have is one of the first's.
            known = {files[path] for _, path in swept[laser][i]}
            swept[laser][i] = (*swept[laser][i], *(each for each in own[j] if files[each[1]] not in known))
    sweeps = {laser: tuple(own) for laser, own in swept.items()}
    others_sweeps = {laser: tuple(own[j] for j in rest) for laser, own in second.views.sweeps.items()}
    if first.views.stripes is None or second.views.stripes is None:
        others = second.views.stripes
        left_stripes = others and {laser: left(paths) for laser, paths in others.items()}
        return replace(first.views, sweeps=sweeps), Views(boards, left_stripes, sweeps=others_sweeps)
    stripes = {laser: list(paths) for laser, paths in first.views.stripes.items()}
    for laser, paths in second.views.stripes.items():
        for i, j in again:
            here, there = stripes[laser][i], paths[j]
            if here is not None and there is not None and files[here] != files[there]:
                raise InputError(
                    f"{second.views.boards[j]}: the stripe in its pose is {here} in {first.path}, and {there} in "
                    f"{second.path}: name the same in both, or the board in one of them alone"
                )
            stripes[laser][i] = here or there
    return (
        Views(first.views.boards, {laser: tuple(paths) for laser, paths in stripes.items()}, sweeps=sweeps),
        Views(boards, {laser: left(paths) for laser, paths in second.views.stripes.items()}, sweeps=others_sweeps),
    )
