"""Does the data determine what was asked? And if not, which direction is missing, why, and how to fix it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.coverage import Coverage
from jaxscan.calibration.uncertainty import UNDETERMINED
from jaxscan.rig import Light, SweptSheet
from jaxscan.rig.camera import lens_numbers
from jaxscan.rig.light import inverse_depths
from jaxscan.rig.rig import is_place, is_stage_shape

# Focal length, light plane, travel or turn known no better than this share of itself is not a measurement.
_LARGEST_RELATIVE_SIGMA = 0.02
# The tilt of a sensor known no better than this, radians, is none: the linear σ does not hold over so wide a range.
_LARGEST_TILT_SIGMA = 0.1
_VECTORS = ("lights", "motion")
# Shares of a direction below this are not worth a word.
_WORTH_NAMING = 0.3
# Corners that fit no better than this (px) contradict the model: no photograph more would change that.
_ROUGH_PX = 1.0
# Boards whose normals differ by less do not show perspective.
_SMALLEST_TILT_SPREAD_DEG = 20.0
# A turn of a board that determines its axis.
_ENOUGH_DEG = 30.0

_IN_WORDS = {
    "camera.focal": "the focal length",
    "camera.principal": "the principal point",
    "camera.tilt": "the tilt of the sensor",
    "shape.bulge.0": "the board's bulge along its columns",
    "shape.bulge.1": "the board's bulge along its rows",
    "shape.twist": "the board's twist",
    "shape.edge": "by how much one edge of the board bends more than the other",
}


@dataclass(frozen=True)
class OpenQuestion:
    """A direction that the data do not determine.

    Attributes:
        words: what is open, a clause of a sentence.
        names: the parameters that take part in it, those with the largest share first.
    """

    words: str
    names: tuple[str, ...]


def undetermined(
    names: list[str],
    values: Float[np.ndarray, "n"],
    eigenvalues: Float[np.ndarray, "all"],
    directions: Float[np.ndarray, "n all"],
    covariance: Float[np.ndarray, "n n"],
    noise_px: float,
) -> OpenQuestion | None:
    """What the data leave open; None when they determine everything.

    Args:
        names: the free parameters.
        values: where the solve ended.
        eigenvalues: of the scaled Schur complement, held parameters among them with 1.
        directions: the free parameters' rows of its eigenvectors, in units of each parameter's single σ.
        covariance: of the free parameters.
        noise_px: the larger σ of corners and stripe points. What exceeds a pixel is bad data, not bad geometry: it is
            for the report to say, and is not held against the photographs' arrangement here.
    """
    if eigenvalues[0] < UNDETERMINED:
        share = np.abs(directions[:, 0]) / np.linalg.norm(directions, axis=1)
        parts = [names[i] for i in np.argsort(-share) if share[i] > _WORTH_NAMING * share.max()]
        words = list(dict.fromkeys(_words(name) for name in parts))
        what = " and ".join(words) + " cannot be distinguished" if len(words) > 1 else f"{words[0]} cannot be found"
        return OpenQuestion(what, tuple(parts))
    sigmas = np.sqrt(np.diagonal(covariance)).tolist()
    # Before the focal length, with which a tilt that is not known is mixed up too.
    tilts = [i for i, name in enumerate(names) if name.startswith("camera.tilt")]
    for i in sorted(tilts, key=lambda i: -sigmas[i])[:1]:
        if sigmas[i] > _LARGEST_TILT_SIGMA:
            return OpenQuestion(
                "the tilt of the sensor and the principal point cannot be distinguished, it came out as "
                f"{np.degrees(values[i]):.1f}° ± {np.degrees(sigmas[i]):.1f}°",
                (names[i],),
            )
    for i, (name, sigma) in enumerate(zip(names, sigmas, strict=True)):
        if name.startswith("camera.focal") and sigma > _LARGEST_RELATIVE_SIGMA * abs(values[i]):
            return OpenQuestion(
                f"the focal length and the boards' distance cannot be distinguished, it came out as {values[i]:.0f} ± "
                f"{sigma:.0f} px ({100 * sigma / abs(values[i]):.0f} %)",
                (name,),
            )
    stems = dict.fromkeys(name.rsplit(".", 1)[0] for name in names if name.startswith(_VECTORS))
    for stem in (
        stem for stem in stems if not is_place(stem) and not _is_shape(stem) and not is_stage_shape(stem, names)
    ):
        at = [i for i, name in enumerate(names) if name.startswith(stem)]
        # In the worst direction of the vector: of ω its length is the sheet's place, its direction the sheet's tilt.
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[np.ix_(at, at)])[-1]))
        relative = sigma / float(np.linalg.norm(values[at])) / max(noise_px, 1.0)
        if relative > _LARGEST_RELATIVE_SIGMA:
            known = (
                f"its uncertainty is {100 * relative:.0f} % of its value" if relative < 1 else "it is lost in the noise"
            )
            words = f"{_words(stem)} is not determined, {known}"
            return OpenQuestion(words, tuple(names[i] for i in at))
    return None


def undetermined_shape(
    light: Light,
    names: list[str],
    covariance: Float[np.ndarray, "n n"],
    rays: Float[np.ndarray, "rays 3"],
    noise_px: float,
    positions: Float[np.ndarray, "positions"] | None = None,
) -> OpenQuestion | None:
    """What is open of a light that is no plane: where its depth, over the nearer half of the image, is not measured.

    Args:
        light: where the solve ended.
        names: of its numbers, in their order.
        covariance: of these.
        rays: of the whole image.
        noise_px: as for `undetermined`.
        positions: of the axis that moves it, motor steps, at which it was seen; None where none does.
    """
    if not any(map(_is_shape, names)):
        return None
    rays = rays[np.isfinite(rays).all(axis=1)]
    w, _, J = inverse_depths(light, rays, None if positions is None else np.resize(positions, len(rays)))
    numbers = [f"{name}.{i}" for name, count in light.numbers.items() for i in range(count)]
    J = J[:, [numbers.index(name.split(".", 2)[2]) for name in names]]
    seen = w > 0
    near = seen & (w >= np.median(w[seen])) if seen.any() else seen
    relative = np.sqrt(np.einsum("ri,ij,rj->r", J[near], covariance, J[near])) / w[near] / max(noise_px, 1.0)
    worst = float(relative.max(initial=0.0))
    if worst <= _LARGEST_RELATIVE_SIGMA:
        return None
    shape = tuple(name for name in names if _is_shape(name))
    share = f"to {100 * worst:.0f} %" if worst < 1 else "not at all"
    return OpenQuestion(
        f"{_words(shape[0])} is not determined: at the edges of the image the sheet's depth is known {share}", shape
    )


def cause_and_fix(question: OpenQuestion, coverage: Coverage, corner_px: float) -> str:
    """Why the direction is open, from what the photographs cover, and which photographs would close it.

    Args:
        question: what is open.
        coverage: what the photographs cover.
        corner_px: σ of a corner.
    """
    name = question.names[0]
    if name.startswith("lights"):
        stripes = coverage.stripes[int(name.split(".")[1])]
        near, far = stripes.depths_mm
        if _is_shape(name) and name.rsplit(".", 2)[1] in SweptSheet.numbers:
            return (
                f"the stripes on the boards of {stripes.views} views are {near:.1f} to {far:.1f} mm from the camera. "
                "Photograph each board with the light at more positions, over its whole sweep, and hold the boards at "
                "distances that differ by a third and more"
            )
        if _is_shape(name):
            return (
                f"the stripes on the boards of {stripes.views} views are {stripes.along_mm:.0f} mm long in all, "
                f"{near:.1f} to {far:.1f} mm from the camera. Let the stripe cross a board at both of its ends, near "
                "the edges of the image, and at distances that differ by a third and more; or take the sheet as flat"
            )
        return (
            f"the stripes on the boards of {stripes.views} views lie between {near:.1f} and {far:.1f} mm from the "
            f"camera and spread by {stripes.across_mm:.1f} mm across themselves. Hold the board at distances that "
            "differ by a third and more, with the stripe on it"
        )
    if name.startswith("motion"):
        axis = name.split(".")[1]
        cover = coverage.axes[axis]
        way = f"by {cover.way:.2f} {cover.unit}" if cover.way is not None else "by an unknown way"
        fix = "Photograph it along the whole travel"
        if cover.unit == "degrees":
            fix = "Turn it by 30° and more, all around where it can be seen"
            if abs(cover.way or 0.0) > _ENOUGH_DEG:
                fix = (
                    "That is enough, so these photographs are not of one turn: see whether the board stood on the same "
                    "place all along, whether it was turned round between two of them, and whether they are in order"
                )
        return f"the {axis} moved the board {way} over {cover.photographs} photographs. {fix}"
    if coverage.tilt_spread_deg < _SMALLEST_TILT_SPREAD_DEG:
        return (
            f"the boards are nearly parallel, their normals lie within {coverage.tilt_spread_deg:.1f}° of each other. "
            "Tilt the board by 30° or more, in different directions from view to view"
        )
    if corner_px > _ROUGH_PX:
        return (
            f"corners fit to {corner_px:.1f} px, where a tenth of a pixel is usual, so that they contradict the model. "
            "See whether the board is flat and its squares are all of one size, whether all photographs show the board "
            "that [board] describes, by one camera, and whether the lens needs more terms"
        )
    if name.startswith("camera.tilt"):
        return (
            f"only the lens's distortion shows where its axis is, and corners cover {100 * coverage.image_share:.0f} % "
            f"of the image and reach {100 * coverage.reach:.0f} % of the way from its centre to its corners. Hold the "
            "board into the corners of the image, choose a lens with fewer terms, or calibrate without the tilt"
        )
    if lens_numbers(name) is not None:
        return (
            f"corners cover {100 * coverage.image_share:.0f} % of the image and reach {100 * coverage.reach:.0f} % of "
            "the way from its centre to its corners. Hold the board into the corners of the image, or choose a lens "
            "with fewer terms"
        )
    return (
        f"the boards' normals lie within {coverage.tilt_spread_deg:.0f}° of each other and their corners cover "
        f"{100 * coverage.image_share:.0f} % of the image. Tilt the board by 30° or more in different directions, and "
        "let it fill the image"
    )


def _is_shape(name: str) -> bool:
    """Whether a parameter says how a light differs from a plane: it may be 0, so a share of it means nothing."""
    return name.startswith("lights.") and ".plane." not in name


def _words(name: str) -> str:
    if name.startswith("lights."):
        if _is_shape(name):
            number = name.split(".")[2]
            return (
                "how the sheet of light turns"
                if number in SweptSheet.numbers
                else f"the {number} of the sheet of light"
            )
        return "the light plane"
    if name.startswith("motion."):
        return f"the motion of the {name.split('.')[1]}"
    if numbers := lens_numbers(name):
        return f"the {numbers} distortion"
    return next((words for stem, words in _IN_WORDS.items() if name.startswith(stem)), name)
