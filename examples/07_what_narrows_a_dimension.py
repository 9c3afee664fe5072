"""Which photograph of the board narrows a dimension most: a scan is measured, and its interval traced to its causes.

A dimension's rig part is what the calibration leaves open. `dimension_gradient` says how far it moves for each pixel
that a corner or a stripe point moves: one reverse pass through the geometry and, implicitly, through the solve. Squared
and times σ² that is each photograph's share of the variance. `narrowed` says what σ would be with one of the
photographs taken once more, and `suggest`, asked for this dimension alone, looks for a better pose than any of them.
"""

from pathlib import Path

import numpy as np
import photographs

import jaxscan
from jaxscan.calibration.next_pose import suggest
from jaxscan.files.part_file import Dimension, Feature, Part
from jaxscan.files.region import Region

calibration = photographs.calibration()
content = calibration.rig_file()
image = jaxscan.reconstruct(content, jaxscan.read_scan(photographs.world() / "scan"))

# The floor to the left and to the right of the cup, around what the frame across the cup's bottom sees there.
across = int(np.argmin(np.abs(image.steps - 36_000)))
spots = {name: image.points[across, column] for name, column in (("left", 200), ("right", 430))}
regions = {name: Region((float(x), float(y), float(z)), None, 16.0) for name, (x, y, z) in spots.items()}
features = tuple(Feature(name, "plane", region) for name, region in regions.items())
part = Part(Path("part.toml"), "floor", features, (Dimension("step", "step", ("left", "right")),))
(step,) = jaxscan.measure(jaxscan.scanned_image(image, content), part).dimensions
assert step.value is not None, step.problem
print(f"right over left: {step.value:.3f} ± {step.uncertainty:.3f} mm; σ of the rig's part {step.sigma_rig:.5f} mm")

gradient = jaxscan.dimension_gradient(calibration, step)
sigma_px, tau = calibration.stripe_sigma_px or 0.0, calibration.stripe_correlation or 1.0
share = {
    name: calibration.corner_sigma_px**2 * (corners**2).sum() + tau * sigma_px**2 * (gradient.stripes[name] ** 2).sum()
    for name, corners in gradient.corners.items()
}
whole = sum(share.values())
for name, noise in sorted(share.items(), key=lambda pair: -pair[1])[:3]:
    print(f"  {name}: {100 * noise / whole:.0f} % of the rig's part is from its corners and stripe")
print(f"σ from all photographs: {np.sqrt(whole):.5f} mm")

again = jaxscan.narrowed(calibration, step)
best = min(again, key=again.__getitem__)
print(f"once more {best}: σ of the rig's part falls to {again[best]:.5f} mm")
(pose,) = suggest(calibration, gradient.by_rig[None], count=1)
b = gradient.by_rig
sigma = float(np.sqrt(b @ pose.covariance.of_leaves(calibration.rig) @ b))
print(f"a new pose, {pose.distance_mm:.0f} mm away, right side {pose.tilt_deg[0]:+.0f}°: it falls to {sigma:.5f} mm")
