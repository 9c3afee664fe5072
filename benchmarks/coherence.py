"""Which of several stripes: the share of lines in which each rule takes the true one.

Stripes are drawn where an ideal camera sees the sheet on a block and a cup on the platform of the simulated rig of
2003, with jumps of depth and columns in which the sheet is in shadow; on top of them

- `glints`: in each frame twenty bright curves 15 to 80 columns long, 0.7 to 2 times as bright as the stripe, elsewhere
  in every frame, as metal shows them;
- `mirror`: a second stripe over all columns, 0.6 to 1.3 times as bright from place to place, that moves the other way
  about, as a polished floor shows it;
- `lost`: glints, and every third frame the stripe is gone in half of the columns;
- `fast`: glints, on a ramp that moves the stripe by 14 px a frame, and back.

Right is a choice within 3 px of the true row, of the columns in which there is one; `offered` are those in which any of
the candidates is right, the most that a rule can reach. About jumps: the same in the columns beside a jump of depth and
in the frames in which a column's stripe has left its course by more than 12 px.
"""

import numpy as np
from jaxtyping import Bool, Float

from benchmarks.metric import Metric
from jaxscan.detectors import Choice
from jaxscan.images.stripes.candidates import candidates, choose
from jaxscan.images.stripes.coarse import coarse_peaks
from jaxscan.simulation import rig_2003, true_profile
from jaxscan.simulation.shapes import box, cup

_ROWS, _COLUMNS = 480, 640
_SIGMA_PX, _GROUND, _HEIGHT, _NOISE = 1.2, 40.0, 110.0, 3.0
_RIGHT_PX, _JUMP_PX = 3.0, 12.0
_RULES: tuple[Choice, ...] = ("strongest", "continuous", "coherent")


def measure(quick: bool) -> list[Metric]:
    """All figures; in the short form fewer frames."""
    frames = 12 if quick else 37
    truth = _truth(frames)
    metrics = []
    print("  share of columns right: offered, " + ", ".join(_RULES) + " (about jumps)")
    for kind in ("glints", "mirror", "lost", "fast"):
        rows = _ramp(frames) if kind == "fast" else truth
        shares = _shares(kind, rows)
        print(f"    {kind:8}" + "".join(f"{all_:9.4f} ({jump:.4f})" for all_, jump in shares.values()))
        stem = f"coherence.{kind}"
        metrics += [Metric(f"{stem}.{name}", share[0]) for name, share in shares.items() if name != "coherent"]
        metrics.append(Metric(f"{stem}.coherent", shares["coherent"][0], "", "higher", floor=0.003))
        metrics.append(Metric(f"{stem}.coherent_about_jumps", shares["coherent"][1]))
    return metrics


def _truth(frames: int) -> Float[np.ndarray, "frames columns"]:
    rig = rig_2003.simulated_rig(0)
    y = rig_2003.OBJECT_Y
    block = box(y, (40.0, 40.0, 25.0)).moved(np.eye(3), np.array([-45.0, 0.0, 0.0]))
    bodies = (block, *(body.moved(np.eye(3), np.array([30.0, 0.0, 0.0])) for body in cup(y)))
    scene = rig_2003.scan_scene(rig, bodies)
    apart = 74000 // frames
    return np.stack([true_profile(rig, scene, {"stage": apart * i}).position for i in range(frames)])


def _ramp(frames: int) -> Float[np.ndarray, "frames columns"]:
    """There and back at 14 px a frame, and a step of 60 px between the columns."""
    there = 60 + np.abs((14.0 * np.arange(frames) + 150) % 600 - 300)
    across = 20 * np.sin(np.arange(_COLUMNS) / 90) + 60 * (np.arange(_COLUMNS) > 250)
    return there[:, None] + across


def _shares(kind: str, rows: Float[np.ndarray, "frames columns"]) -> dict[str, tuple[float, float]]:
    random = np.random.default_rng(len(kind))
    frames = len(rows)
    shown = rows.copy()
    if kind == "lost":
        shown[1::3, 200:520] = np.nan
    images = _GROUND + _NOISE * random.standard_normal((frames, _ROWS, _COLUMNS), np.float32)
    for i in range(frames):
        _draw(images[i], np.arange(_COLUMNS), shown[i], _HEIGHT)
        for _ in range(0 if kind == "mirror" else 20):
            length = int(random.integers(15, 80))
            first = int(random.integers(0, _COLUMNS - length))
            u = np.arange(first, first + length)
            bend, slope = random.uniform(-0.02, 0.02), random.uniform(-1, 1)
            v = random.uniform(20, _ROWS - 20) + slope * (u - first) + bend * (u - first) ** 2
            _draw(images[i], u, v, _HEIGHT * random.uniform(0.7, 2.0))
        if kind == "mirror":
            places = np.arange(_COLUMNS)
            brightness = 0.95 + 0.35 * np.sin(places / 37 + i * 0.9) * np.cos(places / 23 - i * 0.4)
            _draw(images[i], places, 2 * np.nanmedian(rows) + 90 - shown[i], _HEIGHT * brightness)
    images = np.rint(images).clip(0, 255).astype(np.uint8)
    ambient = np.zeros(frames, np.int32)
    found = candidates(coarse_peaks(images, None, ambient, "grey", True), _ROWS, True)
    at, strength = (np.asarray(x) for x in found)
    about = _about_jumps(rows)
    there = np.isfinite(shown)
    with np.errstate(invalid="ignore"):
        near = (np.abs(at - shown[..., None]) < _RIGHT_PX) & (strength > 0)
    offered = np.max(near, axis=2)
    shares = {"offered": (float(offered[there].mean()), float(offered[there & about].mean()))}
    for name in _RULES:
        with np.errstate(invalid="ignore"):
            right = np.abs(choose(at, strength, name) - shown) < _RIGHT_PX
        shares[name] = float(right[there].mean()), float(right[there & about].mean())
    return shares


def _draw(image: np.ndarray, u: np.ndarray, v: Float[np.ndarray, "places"], height: float | np.ndarray) -> None:
    known = np.isfinite(v)
    rows = np.arange(_ROWS)[:, None]
    image[:, u[known]] += np.broadcast_to(height, v.shape)[known] * np.exp(-0.5 * ((rows - v[known]) / _SIGMA_PX) ** 2)


def _about_jumps(rows: Float[np.ndarray, "frames columns"]) -> Bool[np.ndarray, "frames columns"]:
    """Columns beside a jump across, and frames in which a column has jumped off its course."""
    filled = np.where(np.isfinite(rows), rows, -1e3)
    across = np.abs(np.diff(filled, axis=1)) > _JUMP_PX
    about = np.zeros(rows.shape, bool)
    for shift in (-1, 0, 1, 2):
        about |= np.roll(np.pad(across, ((0, 0), (0, 1))), shift, axis=1)
    bend = np.abs(filled[2:] - 2 * filled[1:-1] + filled[:-2]) > _JUMP_PX
    about[2:] |= bend
    about[:-2] |= bend
    return about
