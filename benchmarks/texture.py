"""The texture of a .glb against what was drawn: balls and a printed box, read back by another program (trimesh).

A linear scan with frames 2 mm apart and a photograph of each step with the laser off. Points all over the mesh's
triangles are looked up in the texture. Their true colour is that of the light of the room in a photograph, without
noise and blur, in which they are seen. What lies within 1.5 px of an edge of shape or print in it is a figure by
itself, as for the colours of points (`benchmarks.colour`). Points that some seam is within two texels of are one too.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from benchmarks.colour import EDGE_PX, ROOM, coloured_things, edges, relative
from benchmarks.metric import Metric
from jaxscan.cli.main import main
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.geometry import Pose
from jaxscan.images.sampled import levels_at, sampled
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import read_range_image
from jaxscan.reconstruction.point_colours import least_depths, visible
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.light import Sensor
from jaxscan.simulation.render import carried, render, sight_of, trace
from jaxscan.simulation.scene import Scene

_GOAL: Final = 3.0
_POINTS: Final = 60_000
# How far from a seam a point is that counts as beside it, texels.
_SEAM_TEXELS: Final = 2.0


def measure(quick: bool) -> list[Metric]:
    """From the photographs, and from the points alone; one seed, or three."""
    found: dict[str, list[float]] = {}
    for seed in range(200, 201 if quick else 203):
        for name, value in _measured(seed).items():
            found.setdefault(name, []).append(value)
    metrics = []
    for name, values in found.items():
        target = _GOAL if name.endswith((".rms", ".at_seams")) else None
        unit = "s" if name.endswith("seconds") else "%"
        value = float(np.sqrt(np.mean(np.square(values))))
        metrics.append(Metric(f"texture.{name}", value, unit, "lower" if target else "shown", target, slack=0.2))
    return metrics


def _measured(seed: int) -> dict[str, float]:
    rig = rig_2003.simulated_rig(seed)
    scene = rig_2003.scan_scene(rig, coloured_things(seed))
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        axes = {"stage": tuple(range(0, 72001, 2000))}
        simulate_scan(here / "scan", rig, scene, seed, axes=axes, lighting=ROOM, laser_off=True)
        write_rig(here / "rig.json", RigFile(rig))
        scan = [str(here / "scan"), "--rig", str(here / "rig.json")]
        main(["reconstruct", *scan, "-o", str(here / "a.npz")])
        image = read_range_image(here / "a.npz")
        for name, more in (("photographs", ["--photographs", *scan]), ("points", [])):
            out = here / f"{name}.glb"
            began = time.perf_counter()
            main(["mesh", str(here / "a.npz"), "--floor", "keep", *more, "-o", str(out)])
            found[f"{name}.seconds"] = time.perf_counter() - began
            q = {"stage": int(image.positions["stage"][len(image.valid) // 2])}
            found |= {f"{name}.{key}": value for key, value in errors(rig, scene, q, out, image.points).items()}
    return found


@dataclass(frozen=True)
class Looked:
    """Points on a textured mesh.

    Attributes:
        points: object frame, mm.
        colours: in the texture, 0 to 255.
        from_seam: how far each is from the nearest border of its triangle that is a border of its chart, texels.
    """

    points: Float[np.ndarray, "points 3"]
    colours: Float[np.ndarray, "points 3"]
    from_seam: Float[np.ndarray, "points"]


def looked_up(path: Path, count: int = _POINTS, seed: int = 0) -> Looked:
    """Points all over a .glb, with the colours that a viewer would show there."""
    mesh = trimesh.load_mesh(path, process=False)
    visual: Any = mesh.visual
    picture = np.asarray(visual.material.baseColorTexture.convert("RGB"))
    sampled_points: Any = trimesh.sample.sample_surface(mesh, count, seed=seed)
    points, face = np.asarray(sampled_points[0]), np.asarray(sampled_points[1])
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    rows, columns = picture.shape[:2]
    # trimesh has v upwards, and the files have it downwards.
    u, v = np.asarray(visual.uv).T
    corners = np.stack([u * columns - 0.5, (1 - v) * rows - 0.5], axis=1)[mesh.faces]
    pixels = (corners[face] * weights[..., None]).sum(axis=1)
    # Side i of a triangle is from corner i to the next.
    sides = np.sort(mesh.edges, axis=1)
    key = sides[:, 0].astype(np.int64) * len(mesh.vertices) + sides[:, 1]
    _, which, times = np.unique(key, return_inverse=True, return_counts=True)
    open_side = (times[which] == 1).reshape(-1, 3)
    edge = np.roll(corners, -1, axis=1) - corners
    double = np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    # The corner opposite to side i is i + 2: its weight is the height above the side.
    height = np.roll(weights, -2, axis=1) * (double[:, None] / np.maximum(np.linalg.norm(edge, axis=2), 1e-12))[face]
    from_seam = np.where(open_side[face], height, np.inf).min(axis=1)
    return Looked(points, sampled(picture, pixels), from_seam)


def errors(
    rig: Rig, scene: Scene, q: dict[str, int], path: Path, points: Float[np.ndarray, "frames columns 3"]
) -> dict[str, float]:
    """RMS error over RMS level, %: away from edges, beside them, and at seams away from edges; and what is grey.

    Args:
        rig: the true one.
        scene: as it stands with all axes at 0.
        q: where the axes stand in the photograph that is compared with.
        path: a .glb.
        points: of the scan, which hide what is behind them.
    """
    found = looked_up(path)
    still = render(rig, scene, q=q, lighting=ROOM, sensor=Sensor(blur_px=0.0, noise=0.0, bits=16))
    pose: Pose[np.ndarray] = as_numpy(rig.pose({axis: np.float64(steps) for axis, steps in q.items()}))
    occluders = pose.apply(points[np.isfinite(points).all(axis=-1)].astype(np.float64))
    nearest = least_depths(project_points(rig.camera, occluders).pixels, occluders[:, 2], still.shape[:2])
    seen = pose.apply(found.points)
    pixels = project_points(rig.camera, seen).pixels
    shown = visible(nearest, pixels, seen[:, 2]) & ~_near_edges(rig, scene, q, pixels, 4.0 * EDGE_PX, depth_only=True)
    plain = shown & ~_near_edges(rig, scene, q, pixels, EDGE_PX)
    true = levels_at(still, pixels)
    at_seam = plain & (found.from_seam < _SEAM_TEXELS)
    grey = (found.colours == 128).all(axis=1)
    return {
        "rms": 100 * relative(found.colours[plain], true[plain]),
        "beside_edges": 100 * relative(found.colours[shown & ~plain], true[shown & ~plain]),
        "at_seams": 100 * relative(found.colours[at_seam], true[at_seam]),
        "grey": 100 * float(grey.mean()),
        "compared": 100 * float(plain.mean()),
    }


def _near_edges(
    rig: Rig,
    scene: Scene,
    q: dict[str, int],
    pixels: Float[np.ndarray, "points 2"],
    within_px: float,
    depth_only: bool = False,
) -> Bool[np.ndarray, "points"]:
    u, v = np.meshgrid(*(np.arange(n) for n in rig.camera.image_size))
    grid = pixel_rays(rig.camera, np.stack([u, v], axis=-1).astype(float)).astype(np.float32)
    here = carried(rig, scene, q).cast(np.float32)
    depth, key = trace(here, sight_of(rig.camera, grid))
    smooth = np.zeros(key.shape) if depth_only else np.asarray(here.smooth(key))
    near = np.asarray(
        binary_dilation(edges(smooth, np.asarray(depth)), np.ones((3, 3)), iterations=round(within_px)), bool
    )
    at = np.clip(np.rint(np.nan_to_num(pixels)).astype(int), 0, np.array(rig.camera.image_size) - 1)
    return near[at[:, 1], at[:, 0]]
