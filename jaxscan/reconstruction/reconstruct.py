"""`reconstruct`: from the photographs of a scan to its range image."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.detectors import DEFAULT, Choice, Detector
from jaxscan.errors import InputError, said_of
from jaxscan.files.listing import common_size
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import detect_stripe, read_image, read_video
from jaxscan.images.decode import Image
from jaxscan.reconstruction.point_sigma import point_sigma
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.reconstruction.triangulate import Kernel, triangulate
from jaxscan.rig import Rig

# Photographs decoded, detected and triangulated at a time: memory stays bounded whatever the scan's length.
_BATCH = 16


def reconstruct(
    rig: RigFile | Rig,
    scan: Scan,
    advance: Callable[[int], object] = lambda by: None,
    detector: Detector = DEFAULT,
    choice: Choice = "strongest",
) -> RangeImage:
    """Find the stripe in every frame and triangulate it.

    Args:
        rig: the rig, as `read_rig` gives it; with its covariance the points carry their σ.
        scan: as `read_scan` gives it.
        advance: called with the number of frames done, batch after batch.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.

    Raises:
        InputError: the scan does not fit the rig, a photograph cannot be read, or there is no stripe in any frame.
    """
    content = rig if isinstance(rig, RigFile) else RigFile(rig)
    _check(content.rig, scan)
    with said_of(scan.path):
        kernel = Kernel.create(content.rig, scan.laser.name)
    positions, sigmas, strengths, points, steps = [], [], [], [], []
    for frames, backgrounds, counts in _batches(scan, content.rig.camera.image_size):
        with said_of(scan.path):
            stripe = detect_stripe(frames, scan.laser, backgrounds, detector=detector, choice=choice)
        position = np.where(np.asarray(stripe.valid), np.asarray(stripe.position), np.nan).astype(np.float32)
        positions.append(position)
        sigmas.append(np.asarray(stripe.sigma))
        strengths.append(np.asarray(stripe.strength))
        points.append(_triangulate(kernel, position, counts, scan.laser.columns))
        steps.append(counts)
        advance(len(frames))
    if not steps:
        raise InputError(f"{scan.path}: the scan has no frames")
    image = _with_sigma(content, scan, *(np.concatenate(x) for x in (positions, sigmas, strengths, points, steps)))
    if not np.isfinite(image.pixels).any():
        raise InputError(
            f"{scan.path}: no stripe was found in any of {len(image.steps)} frames: check [laser] color "
            f'("{scan.laser.color}") and columns ({str(scan.laser.columns).lower()}), and look at one with '
            "jaxscan inspect SCAN --frame 0 --png"
        )
    if not image.valid.any():
        raise InputError(
            f"{scan.path}: a stripe was found, but no ray through it meets the rig's light plane within its lens: "
            "check that the rig is that of this scan"
        )
    return image


def _check(rig: Rig, scan: Scan) -> None:
    """Refuse before any long work what cannot come out right."""
    if photographs := [*scan.frames, *scan.backgrounds]:
        size = common_size(photographs)
        if size != rig.camera.image_size:
            raise InputError(_wrong_size(photographs[0], size, rig.camera.image_size))
    if rig.stage is None and (scan.steps_per_frame or len(set(scan.steps)) > 1):
        raise InputError(
            f"{scan.path}: the stage moves between frames, but the rig has no stage: calibrate with a [stage] sequence"
        )
    if scan.exposures_s is not None and len(set(scan.steps)) < len(scan.steps):
        raise InputError(
            f"{scan.path}: [scan] exposures_s: several exposures of one step are not merged yet: list one frame a step"
        )


def _wrong_size(path: Path, size: tuple[int, int], expected: tuple[int, int]) -> str:
    return (
        f"{path}: the photograph has {size[0]} x {size[1]} pixels, the rig was calibrated with "
        f"{expected[0]} x {expected[1]}: use the rig of this camera, at the size it was calibrated for"
    )


def _batches(
    scan: Scan, size: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray | None, Int[np.ndarray, "frames"]]]:
    """Frames, their backgrounds and step counts, some at a time; photographs are decoded on all cores."""
    shared = read_image(scan.backgrounds[0]) if len(scan.backgrounds) == 1 else None
    own = scan.backgrounds if len(scan.backgrounds) > 1 else ()
    done, form = 0, None
    with ThreadPoolExecutor(cpu_count()) as pool:
        for first, images in _chunks(scan, pool):
            form = form or (images[0].shape, images[0].dtype)
            for i, image in enumerate(images):
                path = scan.frames[first + i] if scan.frames else scan.video or scan.path
                if image.shape[1::-1] != size:
                    raise InputError(_wrong_size(path, image.shape[1::-1], size))
                if (image.shape, image.dtype) != form:
                    raise InputError(
                        f"{path}: is {image.dtype} of shape {image.shape}, the first frame {form[1]} of shape "
                        f"{form[0]}: save all frames in one format"
                    )
            background = shared
            if own:
                background = np.stack(list(pool.map(read_image, own[first : first + len(images)])))
            yield np.stack(images), background, _steps(scan, first, len(images))
            done = first + len(images)
    if scan.steps and done < len(scan.steps):
        raise InputError(
            f"{scan.path}: [scan] steps: {len(scan.steps)} step counts, but {scan.video} ends after {done} frames: "
            "copy or record it again, or list the steps of these frames alone"
        )


def _chunks(scan: Scan, pool: ThreadPoolExecutor) -> Iterator[tuple[int, Sequence[Image]]]:
    if scan.video is None:
        for first in range(0, len(scan.frames), _BATCH):
            yield first, list(pool.map(read_image, scan.frames[first : first + _BATCH]))
        return
    first, images = 0, []
    for image in read_video(scan.video):
        images.append(image)
        if len(images) == _BATCH:
            yield first, images
            first, images = first + _BATCH, []
    if images:
        yield first, images


def _steps(scan: Scan, first: int, count: int) -> Int[np.ndarray, "frames"]:
    if scan.steps_per_frame is not None:
        return scan.steps_per_frame * np.arange(first, first + count)
    if first + count > len(scan.steps):
        raise InputError(
            f"{scan.path}: [scan] steps: {len(scan.steps)} step counts, the video goes on to frame {first + count}: "
            "give one for each frame, or steps_per_frame"
        )
    return np.asarray(scan.steps[first : first + count], np.int64)


def _pixels(
    position: Float[np.ndarray, "frames columns"], columns: bool
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """U and v of every stripe point, frame after frame."""
    index = np.broadcast_to(np.arange(position.shape[1], dtype=np.float32), position.shape)
    u, v = (index, position) if columns else (position, index)
    return u.ravel(), v.ravel()


def _triangulate(
    kernel: Kernel, position: Float[np.ndarray, "frames columns"], steps: Int[np.ndarray, "frames"], columns: bool
) -> Float[np.ndarray, "frames columns 3"]:
    u, v = _pixels(position, columns)
    count = np.repeat(steps.astype(np.float32), position.shape[1])
    points = triangulate(kernel, jnp.asarray(u), jnp.asarray(v), jnp.asarray(count))
    return np.asarray(points).reshape(*position.shape, 3)


def _with_sigma(
    content: RigFile,
    scan: Scan,
    positions: Float[np.ndarray, "frames columns"],
    sigmas: Float[np.ndarray, "frames columns"],
    strengths: Float[np.ndarray, "frames columns"],
    points: Float[np.ndarray, "frames columns 3"],
    steps: Int[np.ndarray, "frames"],
) -> RangeImage:
    """The range image with each point's σ.

    How large the errors of stripes are, the calibration has found from its residuals; how they differ from point to
    point, the detector says.
    """
    valid: Bool[np.ndarray, "frames columns"] = np.all(np.isfinite(points), axis=-1)
    sigma = np.full(valid.shape, np.nan, np.float32)
    sigma_pixel = sigma.copy()
    stripe_sigma = content.fit.get("stripe_sigma_px", content.fit.get("stripe_rms_px"))
    if content.covariance is not None and stripe_sigma is not None and valid.any():
        pixels = np.stack(_pixels(positions, scan.laser.columns), axis=-1)[valid.ravel()]
        each = stripe_sigma * (sigmas[valid] / np.median(sigmas[valid])).astype(np.float64)
        count = np.broadcast_to(steps[:, None], valid.shape)[valid].astype(np.float64)
        sigma[valid], sigma_pixel[valid] = point_sigma(
            content.rig, scan.laser.name, content.covariance, each, pixels, count, scan.laser.columns
        )
    stage = content.rig.stage
    return RangeImage(
        points=np.where(valid[..., None], points, np.float32(np.nan)),
        pixels=positions,
        strength=strengths,
        sigma=sigma,
        sigma_pixel=sigma_pixel,
        valid=valid,
        steps=steps,
        per_step=None if stage is None else np.array([float(c) for c in stage.per_step]),
    )
