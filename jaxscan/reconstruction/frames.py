"""The photographs of a scan, decoded ahead: threads fill a ring of buffers while the one before is being measured.

Memory is that of the ring, whatever the scan's length. A buffer holds as many frames as the stripe detector looks at
together, or fewer where they are large, and keeps that size to the end of the scan, so that its last frames are not
compiled for again.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from operator import index
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Int, Shaped, UInt

from jaxscan.deadline import Workers, result_of
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.listing import turned
from jaxscan.files.scan import Scan
from jaxscan.images import read_image, read_video
from jaxscan.images.decode import Image
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.images.stripes.colourless import check_colours
from jaxscan.rig import Positions

# This number of buffers is filled while others are measured.
_FILLED: Final = 2
_SLOT_BYTES: Final = 128 << 20
# What lies on such a boundary is handed to a compiled function without a copy.
_ALIGNMENT: Final = 64
# How photographs in memory are given.
_PAIRS: Final = (
    "give pairs of a photograph and its motor steps, as reconstruct(rig, zip(photographs, range(0, 2000 * n, 2000))) "
    'for n photographs 2000 steps of the stage apart, or (photograph, {"turntable": 20}) for another axis'
)


@dataclass(frozen=True)
class Frames:
    """Some frames of a scan: what its stages hand on to each other.

    Attributes:
        images: a buffer that holds them first; what else is in it is left over. It is used again after the next frames
            are asked for, or later ones (`frames_of_scan`).
        backgrounds: none, one for all frames, or a buffer of one for each.
        positions: of each axis of the scan in its order, motor steps; as many as there are frames.
        inner: which of them the batch is of; the others are their neighbours.
    """

    images: UInt[np.ndarray, "buffer rows columns *rgb"]
    backgrounds: UInt[np.ndarray, "backgrounds rows columns *rgb"] | None
    positions: Int[np.ndarray, "frames axes"]
    inner: slice = field(default_factory=lambda: slice(None))

    @property
    def photographs(self) -> UInt[np.ndarray, "frames rows columns *rgb"]:
        """Those in the buffer that are of these frames."""
        return self.images[: len(self.positions)]

    @property
    def background(self) -> UInt[np.ndarray, "1 rows columns *rgb"] | None:
        """That of all frames, where they have one in common."""
        dark = self.backgrounds
        return dark if dark is not None and len(dark) < len(self.images) else None

    def kept(self) -> Iterator[tuple[Image, Image | None, Int[np.ndarray, "axes"]]]:
        """Each frame, its own background if it has one, and its positions, in memory of their own."""
        own = None if self.background is not None else self.backgrounds
        for i, positions in enumerate(self.positions):
            yield self.images[i].copy(), None if own is None else own[i].copy(), positions


def frames_of_scan(
    scan: Scan, size: tuple[int, int], decoders: int | None = None, kept: int = 1
) -> Generator[Frames, None, None]:
    """The frames of a scan, decoded on all cores, in their order.

    Args:
        scan: as `read_scan` gives it.
        size: columns and rows that every photograph must have.
        decoders: how many threads decode, in place of one for each core; a video has one.
        kept: the last `kept` of the `Frames` that were given out stay as they are.

    Raises:
        InputError: a photograph cannot be read or is unlike the others, there are more or fewer than step counts, or
            those of a coloured laser have no colours.
    """
    with closing(_of_video(scan, size, kept) if scan.video else _of_files(scan, size, decoders, kept)) as read:
        for number, some in enumerate(read):
            if not number:
                check_colours(some.photographs, scan.laser.color, scan.video or scan.frames[0])
            yield some


def with_positions(frames: object) -> Iterator[tuple[Image, Positions]]:
    """Photographs in memory with the positions of the axes by their names; a number is the step count of the stage.

    Raises:
        InputError: what is given is no photographs, or one of them comes without positions.
    """
    if isinstance(frames, str | os.PathLike):
        raise InputError(f'photographs: {frames} is a path: give read_scan("{frames}") for the scan in that folder')
    if not isinstance(frames, Iterable):
        raise InputError(f"photographs: {type(frames).__name__}: {_PAIRS}")
    for number, each in enumerate(frames):
        if not isinstance(each, tuple | list) or len(each) != 2:
            what = f"an array of shape {each.shape}" if isinstance(each, np.ndarray) else f"a {type(each).__name__}"
            raise InputError(f"frame {number}: is {what}, without motor steps: {_PAIRS}")
        photograph, q = each
        if np.ndim(photograph) not in (2, 3):
            raise InputError(f"frame {number}: its photograph is {photograph!r:.60}, and no array of pixels: {_PAIRS}")
        yield np.asarray(photograph), q if isinstance(q, Mapping) else {STAGE: q}


def frames_of(
    images: Iterable[tuple[Image, Positions]], background: Image | None, size: tuple[int, int], batch: int
) -> Iterator[tuple[Frames, tuple[str, ...]]]:
    """Photographs as they come, with the positions of the axes, `batch` at a time; and the axes' names.

    Raises:
        InputError: one is unlike the first, or of another size than the rig's camera, or has not whole motor steps of
            the same axes.
    """
    dark = None if background is None else background[None]
    source, form, axes, count = iter(images), None, (), 0
    while some := list(islice(source, batch)):
        form = form or _Form(some[0][0], size, "frame 0")
        axes = axes or tuple(some[0][1])
        slot = form.buffer(batch)
        positions = np.zeros((len(some), len(axes)), np.int64)
        for k, (image, q) in enumerate(some):
            form.check(image, f"frame {count + k}")
            slot[k], positions[k] = image, _whole_steps(q, axes, f"frame {count + k}")
        count += len(some)
        yield Frames(slot, dark, positions), axes


def _whole_steps(q: Positions, axes: tuple[str, ...], frame: str) -> list[int]:
    """The positions of the axes that the first frame named."""
    if set(q) != set(axes):
        raise InputError(
            f"{frame}: has positions of {', '.join(q) or 'no axis'}, the first frame of {', '.join(axes)}: give those "
            "of the same axes with each"
        )
    try:
        return [index(q[axis]) for axis in axes]
    except TypeError as error:
        given = ", ".join(f"{axis} {q[axis]}" for axis in axes)
        raise InputError(f"{frame}: stands at {given}: give whole motor steps") from error


def aligned(shape: tuple[int, ...], dtype: np.dtype | type[np.generic]) -> Shaped[np.ndarray, "..."]:
    """An array of zeros on a boundary from which a compiled function takes it as it is."""
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(count + _ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % _ALIGNMENT
    return raw[start : start + count].view(dtype).reshape(shape)


class _Form:
    """What all photographs of a scan have in common: the shape and depth of the first."""

    def __init__(self, first: Image, size: tuple[int, int], name: str | Path) -> None:
        self.shape, self.dtype, self.size = first.shape, first.dtype, size
        self.check(first, name)

    def batch(self, buffers: int) -> int:
        """How many fit into each of the buffers that a slot has."""
        image = int(np.prod(self.shape)) * self.dtype.itemsize
        return max(1, min(FRAMES_AT_ONCE, _SLOT_BYTES // (buffers * image)))

    def buffer(self, frames: int) -> UInt[np.ndarray, "frames rows columns *rgb"]:
        """An empty array for `frames` photographs."""
        return aligned((frames, *self.shape), self.dtype)

    def check(self, image: Image, name: str | Path) -> None:
        if image.shape[1::-1] != self.size:
            raise InputError(wrong_size(name, image.shape[1::-1], self.size))
        if (image.shape, image.dtype) != (self.shape, self.dtype):
            raise InputError(
                f"{name}: is {image.dtype} of shape {image.shape}, the first frame {self.dtype} of shape "
                f"{self.shape}: save all frames in one format"
            )

    def read(self, path: Path, out: Image) -> None:
        """Decode a photograph into a buffer."""
        image = read_image(path, out)
        if image is not out:
            self.check(image, path)


def wrong_size(path: Path | str, size: tuple[int, int], expected: tuple[int, int]) -> str:
    """What is said of a photograph of another size than the rig's."""
    smaller = (
        "; for a region of the same sensor set image_size in a copy of rig.json, and subtract the region's first "
        "column and row from principal; for binned pixels calibrate again"
    )
    said = f"{path}: the photograph has {size[0]} x {size[1]} pixels, the rig was calibrated with "
    said += f"{expected[0]} x {expected[1]}: "
    if quarter := turned(size, expected):
        return said + quarter
    return f"{said}use the rig of this camera, at the size it was calibrated for" + (
        smaller if size[0] <= expected[0] and size[1] <= expected[1] else ""
    )


def _of_files(scan: Scan, size: tuple[int, int], decoders: int | None, kept: int) -> Generator[Frames, None, None]:
    count = len(scan.frames)
    if not count:
        return
    form, dark = _Form(read_image(scan.frames[0]), size, scan.frames[0]), _Backgrounds(scan, size)
    batch = form.batch(dark.buffers + 1)

    def fill(first: int, slot: _Slot) -> list[tuple[Future[None], str]]:
        some = range(first, min(first + batch, count))
        tasks = [(workers.submit(form.read, scan.frames[i], slot.images[i - first]), str(scan.frames[i])) for i in some]
        if slot.backgrounds is not None:
            for i in some:
                tasks.append((workers.submit(dark.read, i, slot.backgrounds[i - first]), f"background of frame {i}"))
        return tasks

    slots = [_Slot(form.buffer(batch), dark.buffer(batch)) for _ in range(min(_FILLED + kept, -(-count // batch)))]
    with Workers(decoders) as workers:
        for first, slot in _ring(slots, range(0, count, batch), fill, kept):
            yield Frames(slot.images, dark.of(slot), _positions(scan, first, min(batch, count - first)))


@dataclass(frozen=True)
class _Slot:
    images: UInt[np.ndarray, "buffer rows columns *rgb"]
    backgrounds: UInt[np.ndarray, "backgrounds rows columns *rgb"] | None


class _Backgrounds:
    """The scene with the laser off: not photographed, once for all frames, or once for each."""

    def __init__(self, scan: Scan, size: tuple[int, int]) -> None:
        self._paths, self._form, self._shared = scan.backgrounds, None, None
        if self._paths:
            first = read_image(self._paths[0])
            if len(self._paths) == 1:
                self._shared = first[None]
            else:
                self._form = _Form(first, size, self._paths[0])

    @property
    def buffers(self) -> int:
        """How many they need."""
        return int(self._form is not None)

    def buffer(self, frames: int) -> UInt[np.ndarray, "frames rows columns *rgb"] | None:
        """An empty array for the backgrounds of `frames` photographs; None where they do not have their own."""
        return None if self._form is None else self._form.buffer(frames)

    def read(self, frame: int, out: Image) -> None:
        """Decode that of a frame; of a video's frames beyond the last step count, which are refused, the last one."""
        assert self._form is not None
        self._form.read(self._paths[min(frame, len(self._paths) - 1)], out)

    def of(self, slot: _Slot) -> UInt[np.ndarray, "backgrounds rows columns *rgb"] | None:
        """What belongs to the frames in a buffer."""
        return self._shared if slot.backgrounds is None else slot.backgrounds


def _ring(
    slots: Sequence[_Slot],
    firsts: Iterable[int],
    fill: Callable[[int, _Slot], list[tuple[Future[None], str]]],
    kept: int,
) -> Iterator[tuple[int, _Slot]]:
    """Each full slot in its turn, while those behind it are being filled; the last that were given out are not."""
    to_come, given = iter(firsts), deque[_Slot]()
    under_way = deque((first, slot, fill(first, slot)) for slot, first in zip(slots, to_come, strict=False))
    while under_way:
        first, slot, tasks = under_way.popleft()
        for future, what in tasks:
            result_of(future, what)
        yield first, slot
        given.append(slot)
        if len(given) == kept and (following := next(to_come, None)) is not None:
            slot = given.popleft()
            under_way.append((following, slot, fill(following, slot)))


def _of_video(scan: Scan, size: tuple[int, int], kept: int) -> Generator[Frames, None, None]:
    """A video is decoded by one thread, for each frame needs the one before."""
    video = scan.video or scan.path
    source = read_video(video)
    first = next(source)
    form = _Form(first, size, video)
    dark = _Backgrounds(scan, size)
    batch = form.batch(dark.buffers + 1)
    waiting = [first]

    def fill(done: int, slot: _Slot) -> int:
        count = 0
        while count < batch:
            image = waiting.pop() if waiting else next(source, None)
            if image is None:
                break
            form.check(image, video)
            slot.images[count] = image
            if slot.backgrounds is not None:
                dark.read(done + count, slot.backgrounds[count])
            count += 1
        return count

    slots = deque(_Slot(form.buffer(batch), dark.buffer(batch)) for _ in range(1 + kept))
    done = 0
    with Workers(1) as workers:
        ahead = workers.submit(fill, 0, slots[0])
        while count := result_of(ahead, str(video)):
            slot = slots[0]
            slots.rotate(-1)
            positions = _positions(scan, done, count)
            done += count
            ahead = workers.submit(fill, done, slots[0])
            yield Frames(slot.images, dark.of(slot), positions)
    if not scan.rules and done < scan.listed:
        raise InputError(
            f"{scan.path}: [scan] {scan.listed} positions of the axes, but {scan.video} ends after {done} frames: "
            "copy or record it again, or list the positions of these frames alone"
        )


def _positions(scan: Scan, first: int, count: int) -> Int[np.ndarray, "frames axes"]:
    if scan.rules:
        each = [rule.positions(first, count) for rule in scan.rules.values()]
        return np.asarray(each, np.int64).T
    if first + count > scan.listed:
        raise InputError(
            f"{scan.path}: [scan] {scan.listed} positions of the axes, the video goes on to frame {first + count}: "
            "give one for each frame, or steps_per_frame (of an axis in [scan.axes] start and per_frame)"
        )
    return np.asarray([steps[first : first + count] for steps in scan.axes.values()], np.int64).T
