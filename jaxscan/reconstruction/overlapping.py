"""Batches of frames with their neighbours in time, for whatever looks at several frames together."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import UInt

from jaxscan.images.decode import Image
from jaxscan.reconstruction.frames import Frames


def overlapping(batches: Iterable[Frames], before: int, after: int, size: int) -> Iterator[Frames]:
    """Every frame once, `size` at a time whatever the size of the batches that come in, with neighbours.

    Each batch's buffer holds first neighbours before, its frames, neighbours after, as far as the scan has them. It has
    one size in all batches, so that a shorter batch compiles nothing again; what is left of it is black. No more than
    `before + size + after` frames and one batch that came in are held at a time.

    Args:
        batches: the frames of a scan in their order.
        before: how many neighbours come before the first frame of each batch, where the scan has them.
        after: how many come after its last.
        size: frames of each batch; the last has fewer.
    """
    held: list[tuple[Image, Image | None, np.ndarray]] = []
    shared: UInt[np.ndarray, "1 rows columns *rgb"] | None = None
    done = 0

    def ready(count: int) -> Frames:
        images, darks, positions = zip(*held[: done + count + after], strict=True)
        backgrounds = shared if shared is not None or darks[0] is None else buffer(darks)
        return Frames(buffer(images), backgrounds, np.stack(positions), slice(done, done + count))

    def buffer(images: Sequence[Image]) -> UInt[np.ndarray, "buffer rows columns *rgb"]:
        full = np.zeros((before + size + after, *images[0].shape), images[0].dtype)
        full[: len(images)] = images
        return full

    for batch in batches:
        shared = batch.background if shared is None else shared
        held += batch.kept()
        while len(held) >= done + size + after:
            yield ready(size)
            drop = max(done + size - before, 0)
            held, done = held[drop:], done + size - drop
    while done < len(held):
        count = min(size, len(held) - done)
        yield ready(count)
        done += count
