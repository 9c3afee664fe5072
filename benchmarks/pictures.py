"""`python -m benchmarks.pictures`: the pictures of README and docs.

`scan.png`: a scan beside one of its photographs. `turntable.png`: a full turn beside one of its photographs.

`cup.png`: a cup by the pipeline of 2003 and by ours, coloured by the distance from the true surface, and one profile of
each. `views.png`: the error of a scan against the number of board views in the calibration, by each pipeline.
`texture.png`: a printed box and balls as a textured .glb, as `jaxscan view --png` draws it.
`placing.png`: σ of a point against the angle between laser and camera, and σ of a stripe against its width.
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from benchmarks import transcription
from benchmarks.colour import ROOM, coloured_things
from benchmarks.conditions import SHORT, Condition, Photographed, photograph
from benchmarks.found import Found
from benchmarks.pipelines import MATLAB, OURS, PIPELINES, Taken, matlab
from benchmarks.stripes import profile
from jaxscan.calibration import Observations
from jaxscan.cli import demo
from jaxscan.cli.calibrate import calibrate_session
from jaxscan.cli.compiled import keep_compiled
from jaxscan.cli.main import main as jaxscan
from jaxscan.cli.reconstruct import reconstruct_scan
from jaxscan.cli.simulated_world import simulate_into
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.reconstruction import read_range_image
from jaxscan.reconstruction.point_sigma import ray_jacobian
from jaxscan.rig import Camera, LightPlane, Rig
from jaxscan.simulation import rig_2003, shapes
from jaxscan.simulation.accuracy import cloud_errors
from jaxscan.simulation.distance import distance
from jaxscan.simulation.folders import simulate_scan
from jaxscan.view.matplotlib_setup import pyplot

HERE: Final = Path(__file__).parents[1] / "docs" / "pictures"
# Powers of two: views are padded to these, and each size is compiled.
VIEWS: Final = (4, 8, 16, 32)
_WORDS: Final = {
    MATLAB: "pipeline of 2003",
    "makers": "makers' recipe",
    "opencv": "careful OpenCV",
    "calibration-rs": "calibration-rs",
    OURS: "jaxscan",
}
_COLOURS: Final = {
    MATLAB: "tab:red",
    "makers": "tab:orange",
    "opencv": "tab:blue",
    "calibration-rs": "tab:green",
    OURS: "black",
}
_SCALE_MM, _DPI = 0.8, 100
# Of `placing.png`: a camera of 640 × 480 pixels and a stripe known to a tenth of one.
_FOCAL_PX, _STRIPE_PX = 700.0, 0.1
_BRIGHTEST_OVER_NOISE: Final = 50.0
_DISTANCES_MM: Final = (200.0, 350.0, 600.0)


def main() -> None:
    """Draw one or all."""
    args = command_line().parse_args()
    keep_compiled()
    args.output.mkdir(parents=True, exist_ok=True)
    if args.only in (None, "scan"):
        draw_one_scan(args.output / "scan.png")
    if args.only in (None, "turntable"):
        draw_turn(args.output / "turntable.png")
    if args.only in (None, "cup"):
        draw_cup(args.output / "cup.png")
    if args.only in (None, "views"):
        draw_views(args.output / "views.png", errors_of_seeds(range(args.seeds)))
    if args.only in (None, "texture"):
        draw_textured(args.output / "texture.png")
    if args.only in (None, "placing"):
        draw_placing(args.output / "placing.png")


def command_line() -> argparse.ArgumentParser:
    """What may be asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pictures", description=__doc__)
    parser.add_argument(
        "--only", choices=("scan", "turntable", "cup", "views", "texture", "placing"), help="one of them"
    )
    parser.add_argument("--seeds", type=int, default=10, help="of the second picture (default: 10)")
    parser.add_argument("-o", "--output", type=Path, default=HERE, metavar="DIR", help="default: docs/pictures")
    return parser


def draw_one_scan(path: Path, apart: int = 500) -> None:
    """The panda of the demo, with four times as many photographs, by a rig that was calibrated from photographs."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "world"
        light = {"speckle": rig_2003.SPECKLE}
        simulate_into(out, 0, shapes.panda(rig_2003.OBJECT_Y), "panda", light=light, apart=apart)
        rig = calibrate_session([out / "session"], out / "rig.json").rig
        reconstruct_scan(out / "scan", out / "rig.json", [out / "panda.npz"])
        image, floor = demo.object_alone(read_range_image(out / "panda.npz"))
        demo.draw_picture(out, "panda", image, demo.joined(image), floor, rig)
        path.write_bytes((out / "panda.png").read_bytes())


def draw_turn(path: Path) -> None:
    """What `jaxscan demo --turntable` draws."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        _run(["demo", "--turntable", "-o", str(out)])
        path.write_bytes((out / "panda.png").read_bytes())


def draw_textured(path: Path, seed: int = 200) -> None:
    """The printed things of `benchmarks.colour`, 1 mm between frames, by their true rig, from their photographs."""
    rig = rig_2003.simulated_rig(seed)
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        scene = rig_2003.scan_scene(rig, coloured_things(seed))
        axes = {"stage": tuple(range(0, 72001, 1000))}
        simulate_scan(here / "scan", rig, scene, seed, axes=axes, lighting=ROOM, laser_off=True)
        write_rig(here / "rig.json", RigFile(rig))
        scan, points, mesh = str(here / "scan"), str(here / "things.npz"), str(here / "things.glb")
        seen = ["--rig", str(here / "rig.json")]
        commands = (
            ["reconstruct", scan, *seen, "-o", points],
            ["mesh", points, "--photographs", scan, *seen, "-o", mesh],
            ["view", mesh, "--png", str(path)],
        )
        for command in commands:
            _run(command)


def _run(command: list[str]) -> None:
    if jaxscan(command):
        raise RuntimeError(f"jaxscan {' '.join(command)} failed")


def draw_cup(path: Path, seed: int = 0) -> None:
    """Both clouds of one scan, with the speckle of an ordinary laser."""
    with tempfile.TemporaryDirectory() as folder:
        world = photograph(Path(folder), Condition(lighting={"speckle": rig_2003.SPECKLE}), seed, ("cup",))
        taken = Taken.of(world.session)
        clouds = {name: PIPELINES[name](taken, list(world.scans.values())).clouds[0] for name in (MATLAB, OURS)}
    truth = world.truths["cup"].points
    R, origin = rig_2003.platform(world.rig)
    plt = pyplot()
    figure, axes = plt.subplots(2, 2, figsize=(9, 4.8), height_ratios=(1.15, 1), constrained_layout=True)
    frame = truth.shape[0] // 2
    drawn: Any = None
    for (name, cloud), above, below in zip(clouds.items(), *axes, strict=True):
        errors = cloud_errors(world.scenes["cup"], truth, cloud, np.isfinite(cloud[..., 0]))
        points = cloud[np.isfinite(cloud[..., 0])]
        at = (points - origin) @ R
        off = distance(world.scenes["cup"], points)
        drawn = above.scatter(at[:, 0], at[:, 1], c=off, s=1.2, cmap="inferno_r", vmin=0, vmax=_SCALE_MM, linewidths=0)
        above.set(title=f"{_WORDS[name]}: {errors.absolute:.2f} mm RMS", aspect="equal", xlabel="x, mm", ylabel="y, mm")
        for points, style, words in ((truth, {"color": "tab:green", "lw": 3}, "truth"), (cloud, {}, "measured")):
            profile = (points[frame] - origin) @ R
            style = style or {"color": "black", "lw": 0, "marker": ".", "ms": 3}
            below.plot(profile[:, 0], profile[:, 2], label=words, **style)
        below.set(
            xlabel="x, mm", ylabel="height, mm", xlim=(-24, 24), ylim=(3.8, 6.4), title="the cup's bottom, one frame"
        )
        below.legend(loc="upper right")
    figure.colorbar(drawn, ax=axes, label="distance from the true surface, mm", extend="max", shrink=0.8)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def errors_of_seeds(seeds: Sequence[int]) -> Mapping[str, list[list[float]]]:
    """Errors of each pipeline, for each seed and each number of views."""
    errors: dict[str, list[list[float]]] = {name: [] for name in PIPELINES}
    for seed in seeds:
        for name, of_seed in errors_by_views(seed).items():
            errors[name].append(of_seed)
        print(
            f"seed {seed}: " + "; ".join(f"{name} {np.round(each[-1], 3)}" for name, each in errors.items()), flush=True
        )
    return errors


def draw_views(path: Path, errors: Mapping[str, list[list[float]]]) -> None:
    """Median and quartiles over the seeds."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for name, each in errors.items():
        low, median, high = np.percentile(np.array(each), [25, 50, 75], axis=0)
        axis.plot(VIEWS, median, "o-", color=_COLOURS[name], label=_WORDS[name])
        axis.fill_between(VIEWS, low, high, color=_COLOURS[name], alpha=0.15, lw=0)
    axis.set(xscale="log", yscale="log", xlabel="photographs of the board", ylabel="absolute RMS error of a scan, mm")
    axis.set_xticks(VIEWS, [str(n) for n in VIEWS])
    axis.minorticks_off()
    ticks = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0]
    axis.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axis.grid(alpha=0.3)
    axis.set_ylim(0.014, 1.6)
    axis.legend(loc="upper center", ncols=2)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def draw_placing(path: Path) -> None:
    """Left: σ of a point on the optical axis, along its ray, and the formula z / (f tan θ) σ. Right: σ of a stripe."""
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), constrained_layout=True)
    angles = np.linspace(3.0, 75.0, 49)
    for distance_mm in _DISTANCES_MM:
        sigma = [_STRIPE_PX * millimetres_for_a_pixel(distance_mm, angle) for angle in angles]
        (line,) = left.plot(angles, sigma, label=f"{distance_mm:.0f} mm")
        formula = distance_mm / (_FOCAL_PX * np.tan(np.radians(angles))) * _STRIPE_PX
        left.plot(angles[::4], formula[::4], ".", color=line.get_color())
    left.axvspan(20, 45, color="tab:green", alpha=0.12, lw=0)
    left.set(yscale="log", xlabel="angle θ between laser and line of sight, °", ylabel="σ of a point, mm")
    left.set(title=f"stripe known to {_STRIPE_PX:g} px, f = {_FOCAL_PX:.0f} px")
    left.legend(title="distance")
    widths = np.geomspace(0.5, 4.0, 13)
    for words, height in (("as bright at every width", lambda s: 1.0), ("the same light, spread", lambda s: 0.5 / s)):
        right.plot(widths, [sigma_of_stripe(s, height(s)) for s in widths], ".-", label=words)
    right.set(xscale="log", yscale="log", xlabel="σ of the stripe's profile, px", ylabel="σ of its centre, px")
    right.set(
        title="noise a fiftieth of the brightest stripe", xticks=(0.5, 1, 2, 4), xticklabels=("0.5", "1", "2", "4")
    )
    right.minorticks_off()
    right.set_yticks(ticks := [0.02, 0.05, 0.1, 0.2], [f"{t:g}" for t in ticks])
    right.legend()
    for axis in (left, right):
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def millimetres_for_a_pixel(distance_mm: float, angle_deg: float) -> float:
    """How far a point on the optical axis moves along it if its stripe is seen one row off.

    The sheet meets the axis at this distance and angle: ω = (0, −1 / (z tan θ), 1 / z).
    """
    omega = np.array([0.0, -1 / np.tan(np.radians(angle_deg)), 1.0]) / distance_mm
    middle = np.array([319.5, 239.5])
    rig = Rig(Camera.create((640, 480), [_FOCAL_PX, _FOCAL_PX], middle, "none", []), (LightPlane.create(omega),))
    return abs(float(ray_jacobian(rig, "", middle[None], {}, True)[1][0]))


def sigma_of_stripe(width_px: float, height: float, columns: int = 2000) -> float:
    """RMS error of the stripe's centre as it is detected, px; the noise is a fiftieth of a height of 1."""
    random = np.random.default_rng(0)
    centre = 32 + 4 * np.sin(np.arange(columns) / 40) + random.uniform(-0.5, 0.5, columns)
    levels = height * profile(centre, width_px) + random.standard_normal((64, columns)) / _BRIGHTEST_OVER_NOISE
    image = np.rint(20_000 * (1 + levels)).astype(np.uint16)
    error = detect_stripe(image, StripeSettings("grey")).position[0] - centre
    return float(np.sqrt(np.nanmean(error**2)))


def errors_by_views(seed: int) -> Mapping[str, list[float]]:
    """The absolute error of a scan of the cup, for each number of views, by each pipeline."""
    pipelines = {**PIPELINES, MATLAB: matlab(runner=transcription)}
    with tempfile.TemporaryDirectory() as folder:
        world = photograph(Path(folder), replace(SHORT, views=max(VIEWS)), seed, ("cup",))
        taken = Taken.of(world.session)
        scans = list(world.scans.values())
        return {
            name: [_absolute(world, pipeline(_first(taken, count), scans)) for count in VIEWS]
            for name, pipeline in pipelines.items()
        }


def _first(taken: Taken, count: int) -> Taken:
    """The first `count` views of the board."""

    def some(observations: Observations) -> Observations:
        return replace(observations, views=observations.views[:count])

    return Taken(taken.folder, *(some(each) for each in (taken.own, taken.with_stripe, taken.sub_pix)))


def _absolute(world: Photographed, found: Found) -> float:
    cloud: Float[np.ndarray, "frames columns 3"] = found.clouds[0]
    return cloud_errors(world.scenes["cup"], world.truths["cup"].points, cloud, np.isfinite(cloud[..., 0])).absolute


if __name__ == "__main__":
    main()
