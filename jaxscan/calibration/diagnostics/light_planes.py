"""Does each light plane fit the stripes that it was found from?

Noise of single points says nothing against a plane: it averages out. What neighbours on a stripe share does not: the
middle of a line as thick as the squares moves from square to square, a reflection lies beside, a board bends. Its RMS
distance from the plane, as a share of the distance from the camera, is what the rig will measure wrongly.
"""

from collections.abc import Sequence

import numpy as np

from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape
from jaxscan.calibration.sheet_curve import SheetCurve
from jaxscan.phrases import of_laser

# 1.5 mm in a metre. Good rigs have 0.05, one with plates bent by 0.3 mm at 250 mm has 0.7, a line 60 px thick 3 to 5.
_DOUBTFUL = 0.0015


def light_plane_doubts(shapes: Sequence[StripeShape], curves: Sequence[SheetCurve] = ()) -> tuple[str, ...]:
    """One sentence on each sheet that is curved and each plane that does not fit its own stripes.

    Args:
        shapes: of the stripes.
        curves: of sheets that were taken as flat and are not.
    """
    doubts = [curve.in_words for curve in curves]
    for laser in dict.fromkeys(shape.laser for shape in shapes):
        own = [shape for shape in shapes if shape.laser == laser]
        count = np.array([len(shape.distance_mm) for shape in own], float)
        tied = float(np.sqrt(np.average([shape.tied_mm**2 for shape in own], weights=count)))
        depth = float(np.average([shape.depth_mm for shape in own], weights=count))
        if tied > _DOUBTFUL * depth:
            doubts.append(
                f"The light plane{of_laser(laser)} does not fit the stripes that it was found from: on their boards, "
                f"{depth:.0f} mm away, these lie {tied:.2g} mm RMS beside it, not counting noise. Points will be off "
                "by as much"
            )
    return tuple(doubts)
