"""Does the data determine what was asked? And if not, which direction is missing, in words."""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.uncertainty import UNDETERMINED

# A focal length known no better than this share of itself is not a measurement.
_LARGEST_FOCAL_SIGMA = 0.02
# Shares of a direction below this are not worth a word.
_WORTH_NAMING = 0.3

_IN_WORDS = {
    "camera.focal": "the focal length",
    "camera.principal": "the principal point",
    "camera.radial": "the radial distortion",
    "camera.tangential": "the tangential distortion",
    "laser": "the light plane",
    "stage": "the stage's travel",
}


def undetermined(
    names: list[str],
    values: Float[np.ndarray, "n"],
    eigenvalues: Float[np.ndarray, "all"],
    directions: Float[np.ndarray, "n all"],
    covariance: Float[np.ndarray, "n n"],
) -> str | None:
    """What the data leave open, as a clause of a sentence; None when they determine everything.

    Args:
        names: the free parameters.
        values: where the solve ended.
        eigenvalues: of the scaled Schur complement, held parameters among them with 1.
        directions: the free parameters' rows of its eigenvectors, in units of each parameter's single σ.
        covariance: of the free parameters.
    """
    if eigenvalues[0] < UNDETERMINED:
        share = np.abs(directions[:, 0]) / np.linalg.norm(directions, axis=1)
        parts = [_words(names[i]) for i in np.argsort(-share) if share[i] > _WORTH_NAMING * share.max()]
        several = list(dict.fromkeys(parts))
        return f"{' and '.join(several)} cannot be {'told apart' if len(several) > 1 else 'found'}"
    for i, name in enumerate(names):
        sigma = float(np.sqrt(covariance[i, i]))
        if name.startswith("camera.focal") and sigma > _LARGEST_FOCAL_SIGMA * abs(values[i]):
            return (
                f"the focal length and the boards' distance cannot be told apart: it came out as "
                f"{values[i]:.0f} ± {sigma:.0f} px ({100 * sigma / abs(values[i]):.0f} %)"
            )
    return None


def _words(name: str) -> str:
    return next((words for stem, words in _IN_WORDS.items() if name.startswith(stem)), name)
