"""What photograph would help most: the one place of the report where that is said.

Plain rules from what the photographs cover and from which part of the rig limits a point.
"""

from dataclasses import dataclass

import numpy as np

from jaxscan.calibration.coverage import Coverage
from jaxscan.reconstruction.working_volume import WorkingVolume
from jaxscan.view.report import Figure

# More than this brings little: boards this far apart in tilt, corners reaching so far into the corners of the image.
_TILT_SPREAD_DEG = 50.0
_REACH = 0.85
_ENOUGH_STRIPES = 8


@dataclass(frozen=True)
class Advice:
    """What to photograph next.

    Attributes:
        words: the most useful first.
        figures: that show it.
    """

    words: tuple[str, ...]
    figures: tuple[Figure, ...] = ()


def advise(coverage: Coverage, volumes: tuple[WorkingVolume, ...]) -> Advice:
    """From the weakest part of the coverage, in the order of what limits a point."""
    camera, plane = _camera(coverage), _plane(coverage)
    if not volumes:
        return Advice(tuple(camera) or ("more views like those there are: each σ falls with the root of their number",))
    worst = max(volumes, key=lambda v: v.median_mm)
    if worst.rig_share < 0.5:
        share = 100 * (1 - worst.rig_share)
        words = [
            f"none: {share:.0f} % of a point's variance is the stripe's own, which calibration does not change. A "
            "finer or brighter stripe and a longer exposure in the scans would"
        ]
        return Advice((*words, *camera, *plane))
    first, then = (camera, plane) if worst.if_known_mm["camera"] < worst.if_known_mm["light plane"] else (plane, camera)
    words = [*first, *then]
    return Advice(
        tuple(words) or ("more views like those there are, with the stripe: σ falls with the root of their number",)
    )


def _camera(coverage: Coverage) -> list[str]:
    words = []
    if coverage.tilt_spread_deg < _TILT_SPREAD_DEG:
        turn = _rarest_tilt(coverage)
        words.append(
            f"the board tilted by 30° to 45°, {turn}: so far the boards' normals lie within "
            f"{coverage.tilt_spread_deg:.0f}° of each other"
        )
    if coverage.reach < _REACH:
        words.append(
            f"the board held into the {_emptiest_corner(coverage)} corner of the image and into the others after it: "
            f"corners reach {100 * coverage.reach:.0f} % of the way there"
        )
    return words


def _plane(coverage: Coverage) -> list[str]:
    words = []
    for stripe in coverage.stripes:
        if stripe.views and stripe.views < _ENOUGH_STRIPES:
            near, far = stripe.depths_mm
            which = f' of laser "{stripe.laser}"' if stripe.laser else ""
            words.append(
                f"the board with the stripe{which} across it at the nearest and at the farthest place that you will "
                f"scan: so far {stripe.views} boards between {near:.0f} and {far:.0f} mm show it"
            )
    return words


def _rarest_tilt(coverage: Coverage) -> str:
    """The direction in which boards were tilted least. A normal, which points away, leans towards the nearer edge."""
    tilted = {
        "its right edge nearer": coverage.normals[:, 0].max(),
        "its left edge nearer": -coverage.normals[:, 0].min(),
        "its lower edge nearer": coverage.normals[:, 1].max(),
        "its upper edge nearer": -coverage.normals[:, 1].min(),
    }
    return min(tilted, key=lambda words: tilted[words])


def _emptiest_corner(coverage: Coverage) -> str:
    counts = coverage.corners_in_cells
    rows, columns = counts.shape[0] // 2, counts.shape[1] // 2
    quarters = {
        "upper left": counts[:rows, :columns],
        "upper right": counts[:rows, -columns:],
        "lower left": counts[-rows:, :columns],
        "lower right": counts[-rows:, -columns:],
    }
    return min(quarters, key=lambda words: int(np.sum(quarters[words])))
