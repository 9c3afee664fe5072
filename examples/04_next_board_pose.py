"""Where to hold the board next: the photograph that makes points known best, before it is taken.

What a photograph of the board at some pose would tell of the rig does not depend on what is seen in it, only on where
corners and stripe would be seen. So the covariance *after* it is known before it is taken. `next_best_views` looks for
the pose that makes the mean variance of a point in the working volume least, then for the next one: docs/next-pose.md.
"""

import numpy as np
import photographs

import jaxscan

calibration = photographs.calibration()
planned = jaxscan.next_best_views(calibration, count=2)

print(f"median σ of a point now: {planned.median_now:.4f} {planned.unit}")
for number, (pose, median) in enumerate(zip(planned.poses, planned.medians, strict=True), start=1):
    u, v = pose.outline_px.mean(axis=0)
    right, down = pose.tilt_deg
    sides = f"{'right' if right > 0 else 'left'} side {abs(right):.0f}° and {'lower' if down > 0 else 'upper'} side "
    print(f"photograph {number}: {pose.distance_mm:.0f} mm away, its middle at pixel ({u:.0f}, {v:.0f}), ", end="")
    print(f"{sides}{abs(down):.0f}° towards the camera: σ falls to {median:.4f} mm")

try:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    print("with matplotlib (extra plots) there would be a picture too")
else:
    figure, axes = plt.subplots(figsize=(6.4, 4.8), layout="constrained")
    for view in calibration.observations.views:
        axes.plot(*view.corners.T, ".", color="0.8", markersize=2)
    for number, pose in enumerate(planned.poses, start=1):
        outline = np.concatenate([pose.outline_px, pose.outline_px[:1]])
        axes.plot(*outline.T, color=f"C{number}", label=f"photograph {number}")
        for stripe in pose.stripes_px:
            axes.plot(*stripe.T, ":", color=f"C{number}")
    columns, rows = calibration.observations.image_size
    axes.set(xlim=(0, columns), ylim=(rows, 0), aspect="equal", title="corners so far, and where to hold the board")
    axes.set(xlabel="u, px", ylabel="v, px")
    axes.legend()
    out = photographs.folder() / "next.png"
    figure.savefig(out)
    print(f"drawn: {out}")
