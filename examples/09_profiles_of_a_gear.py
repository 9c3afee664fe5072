"""From the profiles of a laser profiler to points and a surface, with profiles that are computed here.

A profiler looks down from 200 mm on a floor, on which a gear of 14 teeth lies. The motor moves them by 0.05 mm in y for
each of its steps, and after every fifth step there is a profile: 321 points, 0.1 mm apart. Each is a CSV file with x
and z in millimetres, z away from the profiler; a place from which no light comes back has an empty cell. The file
profiles.toml says all of this. A profiler of your own has files that differ in names, units or signs: docs/profiles.md
has the keys for them.
"""

import numpy as np
import photographs

import jaxscan
from jaxscan.cli.main import main

FLOOR, THICK, TEETH = 200.0, 6.0, 14
x = -16.0 + 0.1 * np.arange(321)
random = np.random.default_rng(0)

gear = photographs.folder() / "gear"
(gear / "profiles").mkdir(parents=True, exist_ok=True)
for i in range(140):
    y = 17.5 - 0.25 * i  # of the profile on the gear: what moves by +y shows what is farther in -y
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    rim = 12.0 + 1.5 * np.clip(3.0 * np.sin(TEETH * angle), -1.0, 1.0)
    z = np.where((radius < rim) & (radius > 4.0), FLOOR - THICK, FLOOR) + random.normal(0.0, 0.005, len(x))
    z[np.abs(radius - rim) < 0.06] = np.nan  # beside the teeth's walls
    lines = [f"{a:.2f},{'' if np.isnan(b) else f'{b:.4f}'}" for a, b in zip(x, z, strict=True)]
    (gear / "profiles" / f"profile_{i:03}.csv").write_text("\n".join(["x,z", *lines, ""]))

(gear / "profiles.toml").write_text("""[profiles]
files = "profiles/*.csv"
units = "mm"
steps_per_frame = 5
sigma_mm = 0.005

[[motion]]
axis = "stage"
kind = "linear"
per_step = [0.0, 0.05, 0.0]
""")

points, surface = gear.parent / "gear.npz", gear.parent / "gear.stl"
for command in (["profiles", str(gear), "-o", str(points)], ["mesh", str(points), "-o", str(surface)]):
    if main(command) != 0:
        raise SystemExit(f"jaxscan {' '.join(command)} failed")

image = jaxscan.read_range_image(points)
floor = jaxscan.find_floor(image)
height = floor.height(image.points[jaxscan.stands_on(image, floor)])
print(f"the gear is {np.median(height[height > THICK / 2]):.3f} mm thick; drawn: {THICK:g} mm")
