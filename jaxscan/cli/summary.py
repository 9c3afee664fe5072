"""What `inspect` finds in a file, as plain numbers and texts. Imported by the command when it runs, so freely slow."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from jaxscan.axis_details import POSES, is_detail
from jaxscan.errors import InputError
from jaxscan.files.axes import StepRule
from jaxscan.files.cameras import format_of, read_camera_file
from jaxscan.files.cloud import Cloud, cloud_of
from jaxscan.files.formats import FORMATS
from jaxscan.files.listing import common_size
from jaxscan.files.mesh import has_faces, mesh_of, read_mesh
from jaxscan.files.place_checks import check_values
from jaxscan.files.ply import Element
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.profiles import read_profiles
from jaxscan.files.rig_checks import image_rays
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.session import Session, read_session
from jaxscan.geometry import Pose, matrix_to_vector
from jaxscan.images import StripeSettings
from jaxscan.images.light import Light
from jaxscan.precision import float64
from jaxscan.reconstruction import read_range_image
from jaxscan.rig import Camera, given_poses
from jaxscan.rig.chart import AROUND
from jaxscan.rig.speckle_limit import Optics, limit_of
from jaxscan.rig.summary import axis_summary, light_summary

Summary = dict[str, Any]

# How far points may be from the sheet, in parts of their distance, that a rig is theirs.
_OFF_SHEET = 0.01


def session_summary(path: Path) -> Summary:
    """Summary of a calibration session."""
    session = read_session(path)
    board = session.board
    views = session.views
    stripes = {
        laser.name: [p for i in range(len(views.boards)) for _, p in views.lit(laser.name, i)]
        for laser in session.lasers
    }
    return {
        "kind": "session",
        "path": str(session.path),
        "board": {
            "kind": board.kind,
            "points": list(board.counts),
            "pitch_mm": board.pitch_mm,
            "shape": session.board_shape,
        },
        "image_size": list(session.image_size),
        "lens": session.camera.lens,
        "principal_point": session.camera.principal_point,
        "hold": list(session.camera.hold),
        "tilt": session.camera.tilt,
        "views": len(session.views.boards),
        "stripes": None if views.stripes is None else {name: len(paths) for name, paths in stripes.items()},
        "lasers": [
            {**_laser_settings(laser), "sheet": sheet, "sweep": _sweep(session, laser.name)}
            for laser, sheet in zip(session.lasers, session.sheets or ["plane"] * len(session.lasers), strict=True)
        ],
        "stage": session.stage
        and {
            **_steps(session.stage.steps),
            "motion": session.stage.motion,
            "screw_steps": session.stage.screw_steps,
        },
        "turntable": session.turntable
        and {**_steps(session.turntable.steps), "stage_step": session.turntable.stage_step},
        "poses": session.poses
        and {
            "count": len(session.poses.images),
            "file": str(session.poses.file),
            "moves": session.poses.moves,
            "sigma_mm": session.poses.sigma_mm,
            "sigma_deg": session.poses.sigma_deg,
            **_way(session.poses.poses),
        },
    }


def _sweep(session: Session, laser: str) -> Summary | None:
    """Where a light that is moved stood in the photographs of the boards; None where none moves it."""
    if laser not in session.views.sweeps:
        return None
    sweeps = session.views.sweeps[laser]
    positions = sorted({step for sweep in sweeps for step, _ in sweep})
    return {
        "axis": session.light_axes[laser],
        "boards": sum(map(bool, sweeps)),
        "photographs": sum(map(len, sweeps)),
        "positions": positions,
    }


def scan_summary(path: Path) -> Summary:
    """Summary of a scan."""
    scan = read_scan(path)
    exposures = scan.exposures_s
    photographs = [*scan.frames, *scan.backgrounds]
    return {
        "kind": "scan",
        "path": str(scan.path),
        "name": scan.name,
        "video": scan.video and str(scan.video),
        "frames": None if scan.rules else scan.listed,
        "axes": {
            **{name: _steps(steps) for name, steps in scan.axes.items() if not scan.poses},
            **{name: _rule(rule) for name, rule in scan.rules.items()},
        },
        "poses": scan.poses
        and {
            "count": scan.listed,
            "file": str(scan.poses),
            **_way(given_poses({axis: np.asarray(n, np.float64) for axis, n in scan.axes.items()})),
        },
        "image_size": list(common_size(photographs)) if photographs else None,
        "backgrounds": len(scan.backgrounds),
        "exposures_s": exposures and [min(exposures), max(exposures)],
        "checks": check_values(scan.checks),
        "laser": _laser_settings(scan.laser),
    }


def profiles_summary(path: Path) -> Summary:
    """Summary of a profiler's profiles."""
    profiles = read_profiles(path)
    valid = np.isfinite(profiles.z)
    return {
        "kind": "profiles",
        "path": str(profiles.path),
        "name": profiles.name,
        "profiles": len(valid),
        "points_of_a_profile": valid.shape[1],
        "points": int(valid.sum()),
        "x_mm": [float(np.nanmin(profiles.x)), float(np.nanmax(profiles.x))],
        "z_mm": [float(np.nanmin(profiles.z)), float(np.nanmax(profiles.z))],
        "sigma_mm": profiles.sigma_mm,
        "axes": {name: _steps(positions) for name, positions in profiles.positions.items()},
        "motion": {part.axis: part.kind for part in profiles.motion.parts()},
    }


def rig_summary(path: Path) -> Summary:
    """Summary of a rig. A `sigma` is a standard deviation, None where the file has none."""
    content = read_rig(path)
    rig, covariance = content.rig, content.covariance

    camera = _camera(rig.camera, covariance.sigma if covariance else None)
    return {
        "kind": "rig",
        "path": str(path),
        "camera": camera,
        "lights": light_summary(rig, covariance, image_rays(rig.camera)),
        "motion": axis_summary(rig, covariance),
        "fit": {name: value for name, value in content.fit.items() if name != "warnings"},
        "warnings": list(content.warnings),
    }


def camera_summary(path: Path, name: str | None = None, image_size: tuple[int, int] | None = None) -> Summary:
    """Summary of a camera in the format of another program; `camera` is None where it holds corners alone."""
    content = read_camera_file(path, name=name, image_size=image_size)
    camera = content.camera
    return {
        "kind": "camera",
        "path": str(path),
        "format": FORMATS[format_of(path)].title,
        "image_size": list(content.image_size),
        "camera": None if camera is None else _camera(camera, content.sigma.get if content.sigma else None),
        "views": len(content.views),
        "poses": sum(bool(np.isfinite(view.pose).all()) for view in content.views),
        "corners": sum(int(np.isfinite(view.pixels).all(axis=1).sum()) for view in content.views),
    }


def ply_summary(path: Path) -> Summary:
    """Summary of a PLY file: of a mesh, of points, or of whatever elements it has."""
    content = read_ply_file(path)
    if has_faces(content):
        return _mesh(path, mesh_of(path, content), cloud_of(path, content))
    if not content.elements.get("vertex", Element(0)).count:
        elements = {name: [element.count, list(element.columns)] for name, element in content.elements.items()}
        return {"kind": "PLY", "path": str(path), "format": content.format, "elements": elements}
    cloud = cloud_of(path, content)
    return {
        "kind": "cloud",
        "path": str(path),
        "points": len(cloud.points),
        "box_mm": _box(cloud.points),
        "sigma_mm": _median(cloud.sigma),
        "sigma_pixel_mm": _median(cloud.sigma_pixel),
        "colours": cloud.colours is not None,
    }


def mesh_summary(path: Path) -> Summary:
    """Summary of a triangle mesh."""
    return _mesh(path, read_mesh(path))


def _mesh(path: Path, mesh: trimesh.Trimesh, vertices: Cloud | None = None) -> Summary:
    return {
        "kind": "mesh",
        "path": str(path),
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "box_mm": _box(np.asarray(mesh.vertices)),
        "sigma_mm": _median(vertices.sigma) if vertices else None,
        "sigma_pixel_mm": _median(vertices.sigma_pixel) if vertices else None,
        "area_mm2": float(mesh.area),
        "consistent": bool(mesh.is_winding_consistent),
        "closed": bool(mesh.is_watertight),
        "volume_mm3": float(mesh.volume) if mesh.is_watertight else None,
    }


def range_summary(path: Path) -> Summary:
    """Summary of an organised range image."""
    image = read_range_image(path)
    posed = POSES in image.positions
    steps = {axis: np.asarray(n) for axis, n in image.positions.items() if not is_detail(axis) and axis != POSES}
    return {
        "kind": "range image",
        "path": str(path),
        "frames": len(image.valid),
        "axes": {axis: _steps(n.tolist()) for axis, n in steps.items()},
        "poses": _way(given_poses({axis: np.asarray(n, np.float64) for axis, n in image.positions.items()}))
        if posed
        else None,
        "sweeps": len(image.sweeps()),
        "full_turn": len(image.gaps()) == len(image.valid),
        "columns": image.valid.shape[1],
        "points": int(image.valid.sum()),
        "box_mm": _box(image.points[image.valid]),
        "sigma_mm": _median(image.sigma[image.valid]),
        # Of profiles of other devices it is not known, and 0 stands for it.
        "strength": _median(image.strength[image.valid]) or None,
        "light": None if image.light is None or (light := Light.of([image.light])) is None else asdict(light),
        "notes": list(image.notes),
    }


def speckle_limit_summary(path: Path, rig_path: Path, optics: Optics) -> Summary:
    """What speckle alone leaves of a range image's points, along their rays, and how near they come to it.

    Raises:
        InputError: the points do not lie on the rig's light or have no σ.
    """
    image, rig = read_range_image(path), read_rig(rig_path).rig
    points = image.seen()[image.valid]
    light = None if image.light is None else Light.of([image.light])
    sigma = None if image.sigma_pixel is None else _median(image.sigma_pixel[image.valid])
    if not len(points) or sigma is None:
        raise InputError(f"{path}: has no points with a σ: reconstruct them with a rig that has its covariance")
    if not any(np.median(np.abs(sheet.level(points))) < _OFF_SHEET for sheet in rig.lights):
        raise InputError(f"{path}: its points do not lie on the light of {rig_path}: give the rig of this scan")
    limit = limit_of(rig, points, optics, light.speckle_contrast if light is not None else None, sigma)
    return asdict(limit) | {"times": limit.times}


def _way(poses: Pose[np.ndarray]) -> Summary:
    """How far the hand goes, and by how much it turns from where it is first."""
    turned = matrix_to_vector(poses.matrix() @ poses.matrix()[0].T)
    return {
        "from_mm": poses.translation.min(axis=0).tolist(),
        "to_mm": poses.translation.max(axis=0).tolist(),
        "turn_deg": float(np.degrees(np.linalg.norm(turned, axis=1).max())),
    }


def _camera(camera: Camera, sigma: Callable[[str], float | None] | None) -> Summary:
    return {
        "image_size": list(camera.image_size),
        "lens": camera.lens.kind,
        **{part: _values(f"camera.{part}", getattr(camera, part), sigma) for part in ("focal", "principal")},
        **{name: _values(f"camera.{name}", getattr(camera.lens, name), sigma) for name in camera.lens.numbers},
        **({"tilt": _values("camera.tilt", camera.tilt, sigma)} if camera.tilt else {}),
        **(_reach(camera) if camera.chart is AROUND else {}),
    }


def _reach(camera: Camera) -> Summary:
    """How far off its axis a fisheye images anything, and the share of the image to which no ray comes."""
    with float64():
        widest = float(camera.lens.invertible_radius(np.float64))
    return {
        "reach_deg": float(np.degrees(widest)),
        "image_without_rays": float(np.isnan(image_rays(camera)).any(axis=1).mean()),
    }


def _values(name: str, leaves: Sequence[Any], sigma: Callable[[str], float | None] | None) -> Summary:
    sigmas = [sigma(f"{name}.{i}") for i in range(len(leaves))] if sigma else None
    return {"value": [float(leaf) for leaf in leaves], "sigma": sigmas}


def _laser_settings(laser: StripeSettings) -> Summary:
    return {"name": laser.name, "color": laser.color, "columns": laser.columns}


def _steps(steps: Sequence[int]) -> Summary:
    """How many, from where to where, and how far apart where that is always the same."""
    spacings = {b - a for a, b in pairwise(steps)}
    return {
        "count": len(steps),
        "first_step": steps[0] if steps else None,
        "last_step": steps[-1] if steps else None,
        "spacing": spacings.pop() if len(spacings) == 1 else None,
    }


def _rule(rule: StepRule) -> Summary:
    """As `_steps`, of frames that are not counted."""
    return {"count": None, "first_step": rule.start, "last_step": None, "spacing": rule.per_frame}


def _box(points: Float[np.ndarray, "points 3"]) -> list[list[float]] | None:
    """The lowest and the highest coordinates."""
    finite = points[np.isfinite(points).all(axis=1)]
    return [finite.min(axis=0).tolist(), finite.max(axis=0).tolist()] if len(finite) else None


def _median(values: np.ndarray | None) -> float | None:

    known = values[np.isfinite(values)] if values is not None else ()
    return float(np.median(known)) if len(known) else None
