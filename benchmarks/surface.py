"""From range images to surfaces: cleaning, floor, mesh, PLY, and a real pyramid.

A ball of radius 22 mm, a box and a cup are scanned by the simulated rig of 2003, with the true rig: each alone, from
rendered photographs; in the short form ball and box side by side, the stripe drawn with a noise of 0.06 px where an
ideal camera sees it.

- `object_kept`: of the cleaned points that are truly more than 3 σ above the floor, those that stay (of those
  before cleaning beside it); `floor_left`: of the points that are truly on the floor, those that are left.
- `edges_across_2_mm`: sides of the mesh's triangles across a depth edge wider than 2 mm. Along every side of more than
  2 mm a hundred and more of the camera's rays between its ends are traced in the true scene. Where the surface that
  they meet jumps by more than 2 mm, and the side is somewhere more than 0.25 mm from every true surface, it crosses
  such an edge. (A column whose middle just misses a box still sees its stripe: there the ray jumps, the side does not.)
- `ball.radius_off`: of the ball of least squares through the cleaned points. `box.top_sigma_over_floor_sigma`: scatter
  of the box's top, 1 mm and more from its edges, about its own plane, over the floor's, both within 3 σ; beside it the
  RMS of all of it, and that with its edges.
- `grid.million_triangles_per_s`: range image in, vertices and triangles out, 1000 × 1920 points, the best
  of 8 (other work on the machine makes a single one several times slower), and the median.
- `compare.*`: 10⁶ points against 100 000 small triangles and a plate of two large ones under them, in a process of its
  own: time, memory beyond what it had, and how many pieces of triangles were measured for each point.
- `ply.write_over_plain`: 10 million vertices, against writing and syncing the same bytes, medians of 5 taken in turn.
- The pyramid is scanned with the rig of `stage-pyramid`, its stage turned round: with the sign that it has there a
  tenth of the mesh faces away from the camera. Points belong to the nearest of five planes; those further than 1 mm are
  counted apart.
"""

import os
import re
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Float

from benchmarks.metric import Metric, ratio
from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.cloud import Cloud, write_ply
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.geometry.robust_plane import refined_plane
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.rig import Linear, Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.robust import NORMAL_MAD
from jaxscan.simulation import Body, Scene, distance, rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.shapes import box, cup, sphere
from jaxscan.simulation.vector import Rays, Vec
from jaxscan.surface.clean import clean
from jaxscan.surface.compare import compare
from jaxscan.surface.floor import Floor, find_floor, stands_on
from jaxscan.surface.links import links
from jaxscan.surface.normals import normals
from jaxscan.surface.reference import MeshReference
from jaxscan.surface.triangles import Surface, facing_away, grid_surface

# A range image, and the true points and rows of its frames and columns.
Scan = tuple[RangeImage, Float[np.ndarray, "frames columns 3"], Float[np.ndarray, "frames columns"]]

RADIUS = 22.0
_STRIPE_PX = 0.06
_JUMP_MM = 2.0
_RAYS_ON_A_SIDE = 129
# Points of a side, and how far from every true surface one of them is if the side leaves them, mm.
_POINTS_ON_A_SIDE, _LEAVES_MM = 17, 0.25
# Four σ of the sheet: a stripe nearer to an edge than this lies half on something else.
_SHEET_MM = 1.0
# What is nearer than this to a true surface is on it, mm.
_ON_MM = 1e-3
_PYRAMID_FAR_MM = 1.0


def measure(quick: bool) -> list[Metric]:
    """All of it; the pyramid's photographs only in the full form."""
    return [*simulated(quick), *grid_speed(), *compare_speed(), *ply_speed(), *ply_set(), *([] if quick else pyramid())]


def simulated(quick: bool) -> list[Metric]:
    """Objects on a floor."""
    rig = rig_2003.simulated_rig(0)
    y = rig_2003.OBJECT_Y
    objects = {"ball": (sphere(y, RADIUS),), "box": (box(y),), "cup": cup(y)}
    if quick:
        aside = {"ball": -52.0, "box": -4.0}
        small = {"ball": sphere(y, RADIUS), "box": box(y, (34.0, 40.0, 30.0))}
        both = tuple(body.moved(np.eye(3), np.array([aside[name], 0.0, 0.0])) for name, body in small.items())
        return measured("both", rig, both, True)
    return [metric for name, bodies in objects.items() for metric in measured(name, rig, bodies, False)]


def measured(name: str, rig: Rig, bodies: tuple[Body, ...], drawn: bool) -> list[Metric]:
    """One scene: scanned, cleaned, without its floor, meshed."""
    scene = rig_2003.scan_scene(rig, bodies)
    image, true_points, true_rows = draw(rig, scene) if drawn else photograph(rig, scene)
    R, origin = rig_2003.platform(rig)
    cleaned = clean(image).image
    floor = find_floor(cleaned)
    kept = stands_on(cleaned, floor)
    known = cleaned.valid & np.isfinite(true_points).all(axis=-1)
    true_height = (true_points - origin) @ R[:, 2]
    above, on_floor = known & (true_height > floor.tolerance_mm), known & (np.abs(true_height) < _ON_MM)
    all_above = image.valid & (true_height > floor.tolerance_mm)
    surface = grid_surface(cleaned.where(kept))
    off = distance(scene, image.points[image.valid])
    off_cleaned = distance(scene, cleaned.points[cleaned.valid])
    far, far_cleaned = (float((x > 0.2).sum()) for x in (off, off_cleaned))
    stem = f"surface.{name}"
    metrics = [
        Metric(f"{stem}.object_kept", float(kept[above].mean()), "", "higher", 0.995, floor=0.002),
        Metric(f"{stem}.object_kept_of_all_that_was_scanned", float(kept[all_above].mean()), "", "higher", slack=0.02),
        Metric(f"{stem}.floor_left", float(kept[on_floor].mean()), "", "lower", 0.001, floor=0.0005),
        Metric(f"{stem}.floor_sigma", floor.sigma_mm, "mm"),
        Metric(f"{stem}.edges_across_2_mm", float(across(rig, scene, cleaned, true_rows, surface)), "", "lower", 0),
        Metric(f"{stem}.triangles", float(len(surface.triangles)), "", "higher", slack=0.03),
        Metric(f"{stem}.points_off_by_0.2_mm", far),
        Metric(f"{stem}.points_off_by_0.2_mm.cleaned", far_cleaned, "", "lower", slack=0.2, floor=5),
        Metric(f"{stem}.rms", _rms(off), "mm"),
        Metric(f"{stem}.rms.cleaned", _rms(off_cleaned), "mm", "lower", floor=0.002),
    ]
    middle = (true_points - origin) @ R
    if name in ("ball", "both"):
        centre = np.array([-52.0 if name == "both" else 0.0, rig_2003.OBJECT_Y, RADIUS])
        on_ball = known & kept & (np.abs(np.linalg.norm(middle - centre, axis=-1) - RADIUS) < _ON_MM)
        radius = ball_radius(cleaned.points[on_ball].astype(np.float64))
        metrics.append(Metric(f"{stem}.radius_off", abs(radius - RADIUS), "mm", "lower", 0.02, floor=0.003))
    if name in ("box", "both"):
        x, half_width = (-4.0, 17.0) if name == "both" else (0.0, 30.0)
        from_edge = np.minimum(
            half_width - np.abs(middle[..., 0] - x), 20.0 - np.abs(middle[..., 1] - rig_2003.OBJECT_Y)
        )
        on_top = known & kept & (np.abs(true_height - 30.0) < _ON_MM) & (from_edge > -_ON_MM)
        inner, whole = (
            _from_plane(cleaned.points[on].astype(np.float64)) for on in (on_top & (from_edge > _SHEET_MM), on_top)
        )
        # The floor's σ is that of what is within 3 σ of it, so the top's is too; the RMS of all of it is beside it.
        clipped = inner[np.abs(inner) <= 3 * NORMAL_MAD * np.median(np.abs(inner))]
        metrics += [
            Metric(f"{stem}.top_sigma_over_floor_sigma", _rms(clipped) / floor.sigma_mm, "", "lower", 1.0, floor=0.05),
            Metric(f"{stem}.top_rms", _rms(inner), "mm", "lower", floor=0.003),
            Metric(f"{stem}.top_rms_with_its_edges", _rms(whole), "mm", "lower", floor=0.003),
        ]
    return metrics


def photograph(rig: Rig, scene: Scene) -> Scan:
    """Rendered, and reconstructed with the true rig."""
    with tempfile.TemporaryDirectory() as folder:
        truth = simulate_scan(Path(folder), rig, scene, 1)
        return reconstruct(rig, read_scan(Path(folder))), truth.points, truth.position


def draw(rig: Rig, scene: Scene) -> Scan:
    """Where an ideal camera sees the stripe, plus noise, triangulated with the true rig."""
    steps = rig_2003.STEPS_APART * np.arange(rig_2003.SCAN_FRAMES)
    drawn = drawn_scan(rig, scene, {"stage": steps}, _STRIPE_PX)
    unknown = np.full(drawn.position.shape, np.nan, np.float32)
    return replace(drawn.image, sigma=unknown, sigma_pixel=unknown), drawn.points, drawn.position


def across(
    rig: Rig, scene: Scene, image: RangeImage, true_rows: Float[np.ndarray, "frames columns"], surface: Surface
) -> int:
    """How many sides of the mesh cross a depth edge of the true scene that is wider than 2 mm.

    Rays go through where the stripe truly was: with the noise of a pixel a ray may pass the edge beside its own point.
    """
    sides = np.unique(np.sort(surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    a, b = (surface.vertices[sides[:, i]] for i in (0, 1))
    sides = sides[np.linalg.norm(a - b, axis=1) > _JUMP_MM]
    frame, column = np.divmod(surface.place, image.valid.shape[1])
    row = np.where(np.isfinite(true_rows), true_rows, image.pixels)[frame, column]
    seen = np.stack([column, row, image.steps[frame]], axis=1).astype(np.float64)
    t = np.linspace(0, 1, _RAYS_ON_A_SIDE)[None, :, None]
    between = (1 - t) * seen[sides[:, 0], None] + t * seen[sides[:, 1], None]
    rays = pixel_rays(rig.camera, between[..., :2])
    travel = as_numpy(rig.pose({STAGE: np.float64(1)})).translation
    origin = -between[..., 2:] * travel
    depth = _trace(scene.cast(np.float32), *(jnp.asarray(x, jnp.float32) for x in (origin, rays)))
    X = origin + np.asarray(depth)[..., None] * rays
    jump = sides[np.linalg.norm(np.diff(X, axis=1), axis=-1).max(axis=1) > _JUMP_MM]
    a, b = (surface.vertices[jump[:, i], None].astype(np.float64) for i in (0, 1))
    t = np.linspace(0, 1, _POINTS_ON_A_SIDE)[None, :, None]
    off = distance(scene, ((1 - t) * a + t * b).reshape(-1, 3)).reshape(len(jump), _POINTS_ON_A_SIDE)
    return int((off.max(axis=1) > _LEAVES_MM).sum())


@jax.jit
def _trace(scene: Scene, origin: jax.Array, rays: jax.Array) -> jax.Array:
    return scene.trace(Rays(*(Vec(x[..., 0], x[..., 1], x[..., 2]) for x in (origin, rays))))[0]


def grid_speed() -> list[Metric]:
    """A large range image with a bump, a block, noise and gaps."""
    frames, columns = 1000, 1920
    y, x = np.mgrid[0:frames, 0:columns] * np.array([0.1, 0.05])[:, None, None]
    rng = np.random.default_rng(0)
    z = 300 - 20 * np.exp(-((x - 48) ** 2 + (y - 50) ** 2) / 400) - 10 * (np.hypot(x - 20, y - 20) < 10)
    points = np.stack([x, -y, z + 0.02 * rng.normal(size=x.shape)], axis=-1).astype(np.float32)
    valid = rng.random(x.shape) > 0.01
    points[~valid] = np.nan
    none = np.full(valid.shape, np.nan, np.float32)
    stage = as_numpy(Linear.create([0.0, 0.001, 0.0]))
    image = RangeImage(points, none, none, none, none, valid, {STAGE: 100 * np.arange(frames)}, stage)
    speeds, count = [], 0
    for _ in range(8):
        begin = time.perf_counter()
        count = len(grid_surface(image).triangles)
        speeds.append(count / (time.perf_counter() - begin) / 1e6)
    return [
        # An absolute speed: on a busy machine it was a quarter of what it is on a quiet one.
        Metric("surface.grid.million_triangles_per_s", max(speeds), "", "higher", 5.0, slack=4.0, target_suffices=True),
        Metric("surface.grid.million_triangles_per_s.median", float(np.median(speeds))),
        Metric("surface.grid.triangles", count),
    ]


def compare_speed() -> list[Metric]:
    """A cloud against a mesh with triangles of very different size."""
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        seconds, mib, pieces = process.submit(_compared).result(timeout=600)
    return [
        Metric("surface.compare.seconds", seconds, "s", "lower", 10.0, slack=2.0, target_suffices=True),
        Metric("surface.compare.memory", mib, "MiB", "lower", 1024.0, slack=0.5),
        Metric("surface.compare.pieces_per_point", pieces, "", "lower", 5.0, slack=0.1),
    ]


def _compared() -> tuple[float, float, float]:
    """Seconds, MiB and pieces for each point."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(*[0.5 * (np.arange(224) - 112)] * 2)
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    small = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, d), (a, d, c))])
    sheet = np.stack([x, y, 5 + 2 * np.sin(x / 5) * np.cos(y / 7)], axis=-1).reshape(-1, 3)
    plate = 150.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.concatenate([small, x.size + np.array([[0, 1, 2], [0, 2, 3]])])
    mesh = trimesh.Trimesh(np.concatenate([sheet, plate]), faces, process=False)
    some = rng.integers(0, len(small), 700_000)
    points = np.concatenate([mesh.triangles_center[some], rng.uniform(-150, 150, (300_000, 3)) * [1, 1, 0]])
    points += 0.2 * rng.normal(size=points.shape)
    before, begin = _peak_mib(), time.perf_counter()
    compare(points, MeshReference(mesh))
    seconds, mib = time.perf_counter() - begin, _peak_mib() - before
    closest = ClosestOnTriangles(np.asarray(mesh.triangles))
    closest(points[::100])
    return seconds, mib, closest.looked_at / len(points[::100])


def _peak_mib() -> float:
    """The most memory that this process ever had."""
    return int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1]) / 1024  # pyright: ignore[reportOptionalSubscript]


def ply_speed() -> list[Metric]:
    """10 million vertices."""
    cloud = Cloud(np.random.default_rng(0).normal(size=(10_000_000, 3)).astype(np.float32))
    ours, plain = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.ply"
        write_ply(path, cloud)
        content = path.read_bytes()
        for _ in range(5):
            begin = time.perf_counter()
            write_ply(path, cloud)
            ours.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            with replacing(path) as file:
                file.write(content)
            plain.append(time.perf_counter() - begin)
    return [
        ratio("surface.ply.write_over_plain", float(np.median(ours) / np.median(plain)), 2.0),
        Metric("surface.ply.write_seconds", float(np.median(ours)), "s"),
    ]


def ply_set() -> list[Metric]:
    """The PLY files of other programs."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        return []
    refused = []
    paths = sorted((Path(folder) / "ply").glob("*.ply"))
    for path in paths:
        try:
            read_ply_file(path)
        except InputError as error:
            refused.append(path.stem)
            print(f"  refused: {error}")
    return [
        Metric("surface.ply.files", len(paths)),
        Metric("surface.ply.files_read", len(paths) - len(refused), "", "higher", 38, slack=0.0),
    ]


def pyramid() -> list[Metric]:
    """Four faces and a top of the real pyramid."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        print("  JAXSCAN_DATA is not set: no pyramid")
        return []
    data = Path(folder) / "stage-pyramid"
    return pyramid_of(reconstruct(read_rig(data / "rig.json"), read_scan(data)))


def pyramid_of(seen: RangeImage) -> list[Metric]:
    """The same of its range image, by the rig as it was published."""
    if not isinstance(seen.motion, Linear):
        raise ValueError("the rig has no stage")
    per_step = np.array([float(x) for x in seen.motion.per_step])
    turned = (2 * seen.steps[:, None] * per_step).astype(np.float32)
    other = replace(seen, points=seen.points + turned[:, None], motion=as_numpy(Linear.create(-per_step)))
    metrics = []
    for sign, scanned in (("plus", seen), ("minus", other)):
        image = clean(scanned).image
        floor = find_floor(image)
        image = image.where(stands_on(image, floor))
        metrics.append(Metric(f"surface.pyramid.facing_away.stage_{sign}", facing_away(grid_surface(image), image)))
    return metrics + faces(image, floor)


def faces(image: RangeImage, floor: Floor) -> list[Metric]:
    """Planes through the points of the pyramid by the way that they face."""
    turned = normals(image, links(image)) @ floor.frame.matrix()
    points = floor.frame.inverse().apply(image.points.astype(np.float64))
    tilt = np.degrees(np.arccos(np.clip(turned[..., 2], -1, 1)))
    quarter = np.round(np.degrees(np.arctan2(turned[..., 1], turned[..., 0])) / 90.0) % 4
    height = points[..., 2]
    top = image.valid & (height > np.nanpercentile(height, 99.5) - 1.0)
    planes = {}
    for name, on in {
        "top": top,
        **{f"face_{i}": image.valid & ~top & (quarter == i) & (tilt > 25) & (tilt < 70) for i in range(4)},
    }.items():
        cloud = points[on]
        centre = np.median(cloud, axis=0)
        normal = np.nanmedian(turned[on], axis=0) if name != "top" else np.array([0.0, 0.0, 1.0])
        planes[name] = refined_plane(cloud, centre, normal / np.linalg.norm(normal), within=_PYRAMID_FAR_MM)
    cloud = points[image.valid]
    off = np.stack([(cloud - centre) @ normal for centre, normal in planes.values()])
    own = np.abs(off).argmin(axis=0)
    nearest = np.abs(off).min(axis=0)
    stem = "surface.pyramid"
    metrics = [Metric(f"{stem}.share_further_than_1_mm", float((nearest > _PYRAMID_FAR_MM).mean()), "", "lower", 0.02)]
    slopes = {}
    for i, (name, (_, normal)) in enumerate(planes.items()):
        on = (own == i) & (nearest <= _PYRAMID_FAR_MM)
        slopes[name] = float(np.degrees(np.arccos(abs(normal[2]))))
        metrics += [
            Metric(f"{stem}.{name}.rms", _rms(off[i, on]), "mm", "lower", 0.3, floor=0.01),
            Metric(f"{stem}.{name}.slope", slopes[name], "°"),
            Metric(f"{stem}.{name}.points", float(on.sum())),
        ]
    for a, b in ((0, 2), (1, 3)):
        apart = abs(slopes[f"face_{a}"] - slopes[f"face_{b}"])
        metrics.append(Metric(f"{stem}.slopes_{a}_and_{b}_apart", apart, "°", "lower", 3.0, floor=0.2))
    return metrics


def ball_radius(points: Float[np.ndarray, "points 3"]) -> float:
    """The ball of least squared distances."""
    return float(trimesh.nsphere.fit_nsphere(points)[1])


def _from_plane(points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    """Distances from the plane of least squares."""
    offset = points - points.mean(axis=0)
    return offset @ np.linalg.svd(offset, full_matrices=False)[2][2]


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
