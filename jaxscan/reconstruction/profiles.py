"""The range image of profiles that a profiler has measured: from there on they are what a scan gives.

A profile is a frame, and its nth point is in column n. A point X of the profiler's frame, seen while the axes stood at
q, is at T(q)⁻¹ X in the object frame, as for a camera.
"""

from dataclasses import replace

import numpy as np

from jaxscan.files.profiles import Profiles
from jaxscan.reconstruction.range_image import RangeImage


def range_image_of_profiles(profiles: Profiles) -> RangeImage:
    """The points of profiles in the object frame, which is the profiler's where all axes are at 0.

    σ is that of the profiles, where it is given; `strength` is their intensity, 0 where none is known.
    """
    shape = profiles.z.shape
    seen = np.stack([profiles.x, np.zeros(shape), profiles.z], axis=-1)
    positions = {axis: np.asarray(steps, np.int64) for axis, steps in profiles.positions.items()}
    full = np.ones(shape, np.float32)
    nothing = np.float32(np.nan) * full
    sigma = nothing if profiles.sigma_mm is None else np.float32(profiles.sigma_mm) * full
    strength = np.zeros(shape) if profiles.intensity is None else np.nan_to_num(profiles.intensity)
    image = RangeImage(
        points=seen.astype(np.float32),
        pixels=nothing,
        strength=strength.astype(np.float32),
        sigma=sigma,
        sigma_pixel=sigma,
        valid=np.isfinite(profiles.z),
        positions=positions,
        motion=profiles.motion,
    )
    return replace(image, points=image.from_camera().apply(seen).astype(np.float32))
