"""Which of several stripes: the one that goes on from frame to frame as well as from line to line.

As the object moves, the stripe on it moves too, at a speed that the surface's slope sets: over a few frames it goes on
along a straight line, however fast, while a glint on metal flashes up and jumps. In a line of the image let a candidate
stand at v in frame n, and others at v_a and v_b in the frames n + a and n + b, a and b of −2, −1, 1, 2. It goes on
through the two as well as

    c_ab = max over the other candidates of (1 − |v − (b v_a − a v_b) / (b − a)| / w)₊,

and its support c is the mean of the best three of the six pairs. A depth that jumps between n and n + 1 leaves the
pairs of its own side; a stripe that is lost in one frame leaves those around it. Nothing is carried from frame to
frame: what is lost is found in the frame in which it is back, and a jump in its own.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

# Frames before and after one that its choice depends on.
HALO: Final = 2
_PAIRS = ((-2, -1), (-1, 1), (1, 2), (-2, 1), (-1, 2), (-2, 2))
_BEST = 3
# w, px.
_STRAIGHT_PX = 4.0


def support(
    rows: Int[np.ndarray, "frames lines most"], strength: Float[np.ndarray, "frames lines most"]
) -> Float[np.ndarray, "frames lines most"]:
    """c: how well each candidate goes on in time, 0 to 1.

    Args:
        rows: of the candidates, in consecutive frames of a scan.
        strength: of each; 0 where there is none.
    """
    frames, there, v = len(rows), strength > 0, rows.astype(np.float32)
    hits = np.zeros((len(_PAIRS), *rows.shape), np.float32)
    for i, (a, b) in enumerate(_PAIRS):
        n = np.arange(max(0, -a), frames - max(0, b))
        if not n.size:
            continue
        v_a, v_b = v[n + a][:, :, None, :, None], v[n + b][:, :, None, None, :]
        both = there[n + a][:, :, None, :, None] & there[n + b][:, :, None, None, :]
        off = np.abs(v[n][..., None, None] - (b * v_a - a * v_b) / np.float32(b - a))
        straight = np.where(both, np.maximum(1 - off / np.float32(_STRAIGHT_PX), 0), 0)
        hits[i, n] = np.where(there[n], straight.max(axis=(3, 4)), 0)
    return np.sort(hits, axis=0)[-_BEST:].mean(axis=0)
