"""Eight scans of a figure, turned by hand in between, as one surface.

Each scan is cleaned, its floor is found and taken away, and what stands on it becomes a *side*: points with normals,
and σ of each along its normal. `coarse_register` finds rough poses of the sides, from angles that may
be wrong by 10°; `register` brings all of them together in one least-squares problem over every pair that overlaps, and
gives the covariance of all poses; `merge` makes the surface on which every point weighs by its σ.

The scans are drawn here: the stripe where an ideal camera would see it, with a noise of 0.03 pixels. Range images of
photographs, `jaxscan.reconstruct(rig, jaxscan.read_scan(…))`, take the same path, and on the command line it is
`jaxscan merge 0.npz 1.npz … --turn 45 -o figure.stl`.
"""

import numpy as np
import photographs

import jaxscan
from jaxscan.simulation import rig_2003, shapes
from jaxscan.simulation.drawn import drawn_scan

SIDES, TURN, STEPS = 8, 45.0, np.arange(0, 74_000, 2000)

rig = rig_2003.simulated_rig(0)
random = np.random.default_rng(0)
sides = []
for k in range(SIDES):
    by_hand = TURN * k + (random.uniform(-5, 5) if k else 0.0)
    bodies = rig_2003.turned(shapes.figure(rig_2003.OBJECT_Y), by_hand)
    image = drawn_scan(rig, rig_2003.scan_scene(rig, bodies), {"stage": STEPS}, noise_px=0.03, seed=k).image
    sides.append(jaxscan.side_of_image(f"side {k}", image))
    print(f"{sides[-1].name}: {len(sides[-1].points)} points of the figure")

starts = jaxscan.coarse_register(sides, [TURN * k for k in range(SIDES)])
found = jaxscan.register(sides, starts)
for k, side in enumerate(sides[1:], start=1):
    turn, shift = found.sigma(k)
    print(f"{side.name} stands within {shift:.4f} mm and {np.degrees(turn):.3f}°")
print(f"{len(found.pairs)} pairs overlap; the loop closes within {found.closure_mm:.3f} mm")

merged = jaxscan.merge(sides, found.poses)
out = photographs.folder() / "figure.stl"
merged.mesh.export(out)  # a trimesh.Trimesh
print(f"{len(merged.mesh.faces)} triangles, σ of a vertex {np.nanmedian(merged.sigma):.4f} mm: {out}")
