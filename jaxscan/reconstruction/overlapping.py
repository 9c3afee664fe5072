"""Batches of frames with their neighbours in time, for whatever looks at several frames together."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, UInt

from jaxscan.reconstruction.merged_steps import Batch


class Overlapping(NamedTuple):
    """Some frames of a scan, and neighbours of theirs.

    Attributes:
        frames: a buffer that holds first neighbours before, the frames, neighbours after, as far as the scan has them.
            It has one size in all batches, so that a shorter batch compiles nothing anew; what is left of it is black.
        backgrounds: one for each of these, or one for all, or None.
        positions: of the axes at each, as many as there are frames.
        inner: which of them the batch is of.
    """

    frames: UInt[np.ndarray, "buffer rows columns *rgb"]
    backgrounds: UInt[np.ndarray, "backgrounds rows columns *rgb"] | None
    positions: Int[np.ndarray, "frames axes"]
    inner: slice


def overlapping(batches: Iterable[Batch], before: int, after: int, size: int) -> Iterator[Overlapping]:
    """Every frame once, `size` at a time whatever the size of the batches that come in, with neighbours.

    No more than `before + size + after` frames and one batch that came in are held at a time.

    Args:
        batches: the frames of a scan in their order.
        before: neighbours before the first frame of each batch, where the scan has so many.
        after: neighbours after its last.
        size: frames of each batch; the last has fewer.
    """
    held: list[tuple[np.ndarray, np.ndarray | None, list[int]]] = []
    shared: np.ndarray | None = None
    done = 0

    def ready(count: int) -> Overlapping:
        frames, darks, positions = zip(*held[: done + count + after], strict=True)
        backgrounds = shared if darks[0] is None else buffer(darks)
        return Overlapping(buffer(frames), backgrounds, np.asarray(positions, np.int64), slice(done, done + count))

    def buffer(images: Sequence[np.ndarray]) -> np.ndarray:
        full = np.zeros((before + size + after, *images[0].shape), images[0].dtype)
        full[: len(images)] = images
        return full

    for frames, backgrounds, positions in batches:
        darks: Iterable[np.ndarray | None] = [None] * len(frames)
        if backgrounds is not None and backgrounds.shape == frames.shape:
            darks = backgrounds
        elif backgrounds is not None:
            shared = np.reshape(backgrounds, (1, *frames.shape[1:]))
        held += zip(frames, darks, positions.tolist(), strict=True)
        while len(held) >= done + size + after:
            yield ready(size)
            drop = max(done + size - before, 0)
            held, done = held[drop:], done + size - drop
    while done < len(held):
        count = min(size, len(held) - done)
        yield ready(count)
        done += count
