"""`python -m benchmarks`: measure, print a table, keep the figures, and compare them with the committed baseline."""

import argparse
import importlib
import json
import os
import sys
import time
from pathlib import Path

from benchmarks.metric import Metric
from jaxscan.atomic import check_writable, replacing
from jaxscan.errors import InputError

HERE = Path(__file__).parent
BASELINE = HERE / "baseline.json"
SUITES = {
    "growth": "time of a calibration over the number of views, against OpenCV's",
    "real": "real photographs and published answers (needs JAXSCAN_DATA)",
    "board_shape": "boards that are not flat: error of the rig over that of flat ones, what is named, time of a step",
    "parallel": "parallel boards beside tilted ones: error of points, in mm and in σ, what is refused",
    "corners": "corners of checkerboards: accuracy, σ and speed, beside OpenCV's, and what a calibration gains",
    "stripes": "stripe detectors against the Cramér-Rao bound, at a step of reflectance, among spots, on a real bed",
    "speckle": "stripe detectors under speckle: bound, best detector, σ, edges of reflectance, by contrast and grain",
    "bad_light": "denoised and enlarged photographs, flicker, unlisted exposures, laser profiles: σ and what is said",
    "clutter": "what is no stripe: highlights, ghosts, lamps, windows; weak light: strays, and the stripe that is kept",
    "jpeg": "step heights from JPEG, chroma at full and half resolution: three lasers, narrow and burnt out; σ",
    "cup_jpeg": "a scan of a cup kept as JPEG: error of the stripe's place over gravity's, σ over the error",
    "mosaic": "a sensor with a mosaic of colour filters: error over full colour's and gravity's, σ, by interpolation",
    "video": "a moving stripe in MPEG-4 and H.264: error over gravity's, σ, by width and height",
    "cameras": "what cameras do to a stripe: curves, uneven pixels, lenses out of focus, scaling: over gravity, σ",
    "stray_light": "a second reflection or the room's light beside a stripe: error over gravity's, σ",
    "painted": "a stripe on paint of many colours in the light of a room: error over gravity's, σ, kept, strays",
    "known_jpeg": "which photographs are known as JPEGs by their blocks, by quality and noise; false alarms",
    "frame_sigma": "predicted σ over the actual scatter in each frame of a scan, by camera, with and without speckle",
    "throughput": "the kernel, detection and a scan from files to points against their limits; memory",
    "device": "detection and the kernel on JAX's device, a GPU where there is one: transfer and work apart",
    "batch": "many scans, killed and continued; a cluster that loses a worker",
    "exposures": "exposures of a step merged: reflectances 1:50 against each exposure by itself; speed",
    "spacetime": "spacetime analysis: its σ; a border of reflectance, edges of depth, step size",
    "coherence": "which of several stripes: the share of lines in which each rule takes the true one",
    "simulated": "the simulated rig of 2003: predicted against actual error, clouds, joint against sequential",
    "accuracy": "the same photographs through the pipeline of 2003, makers' recipe, careful OpenCV and ours",
    "headline": "the comparison's first table: four pipelines on the same photographs, with speckle and without",
    "speed": "reconstruction and calibration against the pipeline of 2003 in Octave",
    "montecarlo": "predicted against actual scatter of everything that is estimated, and against the Cramér-Rao bound",
    "montecarlo_turning": "the same of a rig with a turntable, and of points scanned while it turns",
    "montecarlo_fisheye": "the same of a rig with a fisheye",
    "fisheye": "a fisheye beyond 90°: round trip, OpenCV's minimum, the kernel, predicted against actual scatter",
    "concurrency": "calibrations two at a time on 1 to 16 threads, boards of 12 to 600 corners: none hangs",
    "derivatives": "derivatives through a solution: block-arrow against dense, digits and time",
    "starts": "whether a calibration ends in the same minimum wherever it starts",
    "nist": "the 27 nonlinear regression problems of NIST through the same solver (needs JAXSCAN_DATA)",
    "curved": "balls and cylinders under a sheet with a thickness: error of stripes, with it known and without",
    "gauge": "a step block, alone and with the boards, puts a light plane right: how other blocks read",
    "lasers": "two lasers on one camera, calibrated in one solve: do their clouds agree within σ?",
    "next_pose": "three photographs as suggested against three more like those there are, really added and solved",
    "hardware": "serial sessions with faults, scans killed and resumed, a simulated scanner from hardware to points",
    "crashes": "programs killed, cables pulled, disks full at 140 moments: lost, doubled, the next order",
    "lost_steps": "motors that stall, loads that are pushed, bad lines: wrong places that no check marks",
    "lab": "the lab server: 200 watchers and one operator, and what watching costs the scan",
    "stop": "POST /api/stop under watchers, clouds, sign-ins, half-open sockets, a full disk and a batch job",
    "stop_tls": "the same of a server that speaks TLS itself",
    "surface": "cleaning, floor, mesh and PLY: accuracy and speed (a real pyramid with JAXSCAN_DATA)",
    "merge": "eight views of a figure joined: poses, loop, merged surface, against pairs that are chained",
    "changes": "what moved between two photographs: named with the right one, by size; false alarms",
    "split": "sessions in which something moved, solved in two parts: which parts differ, points over each part alone",
    "sensors": "sensors that are tilted: points over an upright one's, σ, kernel",
    "left_over": "faults without a term: the rig within 3 of its widened sigma",
    "models": "the model that is chosen for sessions of ten kinds, and what choosing costs",
    "photographed": "boards, sheets and stages that are not as they should be, photographed: points, the chosen model",
    "splined": "a splined lens over what no formula follows: rays, points, σ, and what it costs a lens that one does",
    "sheets": "sheets of light that are not flat: points over a flat sheet's, what is named, kernel and step",
    "stages": "stages that are no lines: points over a line's, what is named, false names, cost",
    "play": "play of a stage by its direction of approach: points over a line's, what is named, false names, z, cost",
    "robot": "given poses: where the hand is, in σ and against a closed form; scans at poses with errors",
    "swept": "a light that sweeps: points in σ, a mirror off its axis, scans against those on a stage",
    "turntable": "a turntable from photographs of the board: axis, angle and place against their σ; scans posed by it",
    "turning": "scans of a figure while it turns: against the true rig and the makers' recipe, the seam, σ",
    "colour": "colours and albedo of points against what was drawn, along a stage and in a turn",
    "texture": "the texture of a .glb against what was drawn, from photographs and from points; seams",
    "formats": "ten million points through each format and back: error, time, memory",
    "measure": "dimensions of drawn parts: coverage of their intervals, bias, false accepts, a million points",
    "parts": "a photographed part with twelve features: coverage of intervals, errors over those of RANSAC and a fit",
    "demo": "time and memory of the whole demo",
    "silence": "how long the screen stands still: the first word and the longest pause of each command, cold",
}
# What takes minutes even in its short form, or says nothing in it; `--only` runs it all the same.
NOT_QUICK = {
    "crashes",
    "lost_steps",
    "stop",
    "stop_tls",
    "board_shape",
    "parallel",
    "concurrency",
    "device",
    "derivatives",
    "starts",
    "next_pose",
    "montecarlo",
    "montecarlo_turning",
    "montecarlo_fisheye",
    "fisheye",
    "gauge",
    "lasers",
    "accuracy",
    "headline",
    "speed",
    "spacetime",
    "speckle",
    "bad_light",
    "clutter",
    "stray_light",
    "jpeg",
    "frame_sigma",
    "coherence",
    "exposures",
    "merge",
    "robot",
    "swept",
    "turntable",
    "turning",
    "changes",
    "split",
    "sensors",
    "left_over",
    "models",
    "photographed",
    "splined",
    "sheets",
    "stages",
    "play",
    "batch",
    "colour",
    "formats",
    "measure",
    "parts",
    "lab",
    "growth",
    "silence",
}


def main() -> int:
    """Run the suites that were asked for."""
    parser = command_line()
    args = parser.parse_args()
    # What takes hours must not fail at its end.
    try:
        for path in (args.json, BASELINE if args.save_baseline else None):
            if path is not None:
                check_writable(path)
    except InputError as error:
        parser.error(str(error))
    data = os.environ.get("JAXSCAN_DATA")
    if data and not Path(data).is_dir():
        parser.error(f"JAXSCAN_DATA is {data}, and there is no such folder: set it right, or unset it")
    metrics: list[Metric] = []
    for name in args.only or [name for name in SUITES if not (args.quick and name in NOT_QUICK)]:
        print(f"\n{name}: {SUITES[name]}", flush=True)
        begin = time.monotonic()
        found = importlib.import_module(f"benchmarks.{name}").measure(args.quick)
        for metric in found:
            print("  " + _line(metric), flush=True)
        print(f"  ({time.monotonic() - begin:.0f} s)", flush=True)
        metrics += found
    key = "quick" if args.quick else "full"
    figures = {metric.name: metric.value for metric in metrics}
    if args.json:
        _write(args.json, {"kind": key, "figures": figures})
    stored = json.loads(BASELINE.read_text(encoding="utf-8")) if BASELINE.exists() else {}
    if args.save_baseline:
        stored[key] = dict(sorted({**stored.get(key, {}), **figures}.items()))
        _write(BASELINE, stored)
        return 0
    return _gate(metrics, stored.get(key, {})) if args.gate else 0


def _write(path: Path, content: dict) -> None:
    with replacing(path, "w") as file:
        file.write(json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def command_line() -> argparse.ArgumentParser:
    """What may be asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure accuracy and speed.",
        epilog="suites:\n" + "\n".join(f"  {name:18} {words}" for name, words in SUITES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", choices=SUITES, action="append", help="one suite; may be given more than once")
    parser.add_argument("--quick", action="store_true", help="fewer seeds and sizes: under three minutes")
    parser.add_argument("--gate", action="store_true", help="fail where a figure is worse than the baseline")
    parser.add_argument("--save-baseline", action="store_true", help="make these figures the baseline")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON too")
    return parser


def _line(metric: Metric) -> str:
    reached = metric.reaches_target()
    goal = "" if reached is None else f"  goal {'≤' if metric.better == 'lower' else '≥'} {metric.target:g}"
    mark = {None: " ", True: "✓", False: "✗"}[reached]
    return f"{mark} {metric.name:58} {metric.value:>12.6g} {metric.unit:5}{goal}"


def _gate(metrics: list[Metric], baseline: dict[str, float]) -> int:
    """0 when no figure is worse than the baseline."""
    worse = [m for m in metrics if m.name in baseline and m.worse_than(baseline[m.name])]
    unknown = [m for m in metrics if m.better != "shown" and m.name not in baseline]
    for metric in worse:
        print(f"worse than the baseline: {metric.name} {metric.value:.6g}, was {baseline[metric.name]:.6g}")
    for metric in unknown:
        print(f"not in the baseline: {metric.name}; add it with --save-baseline")
    compared = sum(m.better != "shown" and m.name in baseline for m in metrics)
    print(f"gate: {compared} figures compared, {len(worse)} worse, {len(unknown)} unknown")
    return 1 if worse or unknown or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
