"""From photographs of an object to its points, each with its σ.

One photograph gives one profile: in each image column the stripe's centre, v, to a few hundredths of a pixel. The
pixel's ray x meets the sheet of light, ω · X = 1, in X = x / (ω · x); from there the stage's travel is taken off. The
result is a *range image*, frames × columns, in the order in which the points were seen, so that neighbours are known:
what cleaning, meshing and merging need.

Two σ go with each point, along its ray. `sigma_pixel` is the stripe's part, which differs from point to point;
`sigma` has the rig's part in it too, which neighbours share, so that no average removes it.
"""

import numpy as np
import photographs

import jaxscan

rig = photographs.rig()
scan = jaxscan.read_scan(photographs.world() / "scan")
image = jaxscan.reconstruct(rig, scan)

frames, columns = image.valid.shape
print(f"{image.valid.sum()} points in {frames} frames of {columns} columns")
print(f"σ of a point: {np.median(image.sigma[image.valid]):.3f} mm", end=", of which the stripe's part is ")
print(f"{np.median(image.sigma_pixel[image.valid]):.3f} mm")

# A part is left as a person would point at it: without the floor, and only what is known well.
floor = jaxscan.find_floor(image)
cup = image.where(jaxscan.stands_on(image, floor) & (image.sigma < 0.2))
print(f"{cup.valid.sum()} of them stand on the floor and are known to better than 0.2 mm")

out = photographs.folder()
jaxscan.write_points(out / "cup.npz", image)  # the range image, for `jaxscan mesh`
jaxscan.write_points(out / "cup.ply", cup)  # a cloud, with both σ, for everything else
print(f"written: {out / 'cup.npz'}, {out / 'cup.ply'}")

try:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    print("with matplotlib (extra plots) there would be a picture too")
else:
    points = image.points[image.valid]
    figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
    drawn = axes.scatter(
        points[:, 0], points[:, 1], c=image.sigma[image.valid], s=1, vmax=np.quantile(image.sigma[image.valid], 0.99)
    )
    axes.set(xlabel="x, mm", ylabel="y, mm (down, as the camera sees it)", aspect="equal")
    axes.invert_yaxis()
    figure.colorbar(drawn, label="σ along the ray, mm")
    figure.savefig(out / "sigma.png")
    print(f"drawn: {out / 'sigma.png'}")
