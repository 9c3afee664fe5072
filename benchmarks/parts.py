"""A part with twelve features, photographed: do the 95 % intervals hold the truth, and how far off is a peer?

For each seed the simulated rig of 2003 photographs its boards, is calibrated from them, and scans the part of
`benchmarks.photographed_part`, all with an ordinary laser's speckle (contrast 0.2). What is measured in the points,
beside the truth, is ours with its interval, and a peer's (`benchmarks.peer_fits`). The drawn scans of
`benchmarks.measured_parts` go to the same peer. A ratio of RMS errors over twenty scans is itself uncertain by a fifth.
"""

import os
import tempfile
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measure import binomial
from benchmarks.measured_parts import SCENES, drawn_rig, scan
from benchmarks.metric import Metric
from benchmarks.peer_fits import PEER, has, peer_shapes
from benchmarks.photographed_part import Photographable, part_of
from jaxscan.calibration import calibrate
from jaxscan.calibration.observe import observe
from jaxscan.files.part_file import Dimension, Part
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.measurement.measure import measure as measure_part
from jaxscan.measurement.scanned import scanned_image
from jaxscan.measurement.shapes import Shape
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import ScanTruth, simulate_scan, simulate_session

SEEDS, QUICK_SEEDS = 20, 2
_FRAMES, _APART = 74, 1000
# How near to a shape a peer's points lie: three times the noise, mm.
_PHOTOGRAPHED_MM, _DRAWN_MM = 0.15, 0.3
_LEAST, _MOST, _OF_PEER = 90.0, 99.0, 0.7
# Dimensions of one round shape.
_ROUND = ("radius", "cone_angle")


@dataclass(frozen=True)
class Taken:
    """A scan of the part.

    Attributes:
        part: on the true rig's platform.
        rig: as it was calibrated.
        image: reconstructed with it.
        truth: of the scan.
    """

    part: Photographable
    rig: RigFile
    image: RangeImage
    truth: ScanTruth


def photographed(seed: int, speckle: float = rig_2003.SPECKLE) -> Taken:
    """Photographs of boards and of the part, from session to points."""
    boards, objects = (replace(each, speckle=speckle) for each in (rig_2003.BOARD_LIGHTING, rig_2003.SCAN_LIGHTING))
    with tempfile.TemporaryDirectory() as folder:
        session, scan = Path(folder) / "session", Path(folder) / "scan"
        true = simulate_session(session, seed, lighting=boards).rig
        rig = calibrate(observe(read_session(session))).rig_file()
        part = part_of(true)
        scene = rig_2003.scan_scene(true, part.bodies)
        truth = simulate_scan(scan, true, scene, seed, frames=_FRAMES, steps_apart=_APART, lighting=objects)
        return Taken(part, rig, reconstruct(rig, read_scan(scan)), truth)


@dataclass(frozen=True)
class Compared:
    """A dimension of one scan.

    Attributes:
        ours: as it was measured.
        off: ours less the truth.
        peer_off: the peer's less the truth; NaN where it has no such dimension.
    """

    ours: MeasuredDimension
    off: float
    peer_off: float


Found = dict[str, list[Compared]]


def measure(quick: bool) -> list[Metric]:
    """Twenty seeds, or two, from JAXSCAN_FIRST_SEED on; photographed with a speckle of JAXSCAN_SPECKLE."""
    first = int(os.environ.get("JAXSCAN_FIRST_SEED", "0"))
    speckle = float(os.environ.get("JAXSCAN_SPECKLE", rig_2003.SPECKLE))
    seeds = range(first, first + (QUICK_SEEDS if quick else SEEDS))
    photographs: Found = defaultdict(list)
    for seed in seeds:
        taken = photographed(seed, speckle)
        compare(photographs, taken.image, taken.rig, taken.part.part, taken.part.truth, _PHOTOGRAPHED_MM)
        inside = [_holds(each[-1]) for each in photographs.values()]
        print(f"  seed {seed}: {int(taken.image.valid.sum())} points, {sum(inside)} of {len(inside)} hold", flush=True)
    drawn: Found = defaultdict(list)
    for make in SCENES:
        scene = make()
        for seed in seeds:
            random = np.random.default_rng([78, seed])
            rig = drawn_rig(random)
            compare(drawn, scan(scene, rig, random), rig, scene.part, lambda d, _, s=scene: s.truth[d.name], _DRAWN_MM)
    print(f"  the peer's planes and balls are found by {PEER}")
    return [*coverage(photographs), *ratios("photographed", photographs), *ratios("drawn", drawn)]


def compare(
    found: Found,
    image: RangeImage,
    rig: RigFile,
    part: Part,
    truth: Callable[[Dimension, dict[str, Shape]], float],
    within: float,
) -> None:
    """Measure a scan by ours and by the peer, and add what comes out."""
    ours = measure_part(scanned_image(image, rig, part), part)
    fitted = {each.feature.name: each.shape for each in ours.features if each.shape is not None}
    peer = peer_shapes(image.points[image.valid].astype(np.float64), part, within, image.cameras()[0])
    for each in ours.dimensions:
        assert each.value is not None, f"{each.dimension.name}: {each.problem}"
        off = each.value - truth(each.dimension, fitted)
        peer_off = np.nan
        if has(peer, each.dimension):
            peer_off = peer.value(each.dimension) - truth(each.dimension, peer.fitted)
        found[each.dimension.name].append(Compared(each, off, peer_off))


def _holds(each: Compared) -> bool:
    assert each.ours.interval is not None
    assert each.ours.value is not None
    return each.ours.interval[0] <= each.ours.value - each.off <= each.ours.interval[1]


def coverage(found: Found) -> list[Metric]:
    """Coverage of all intervals, and of each dimension's, with RMS errors in units of σ."""
    metrics, of_all, outside = [], [], 0
    for name, each in found.items():
        hits = [_holds(one) for one in each]
        of_all += hits
        low, high = binomial(sum(hits), len(hits))
        outside += 100 * high < _LEAST or 100 * low > _MOST
        key = f"parts.{name.replace(' ', '_')}"
        off, sigma = np.array([one.off for one in each]), np.array([one.ours.sigma for one in each], float)
        metrics += [
            Metric(f"{key}.coverage", 100 * float(np.mean(hits)), "%"),
            Metric(f"{key}.rms_error", _rms(off), each[0].ours.dimension.unit),
            Metric(f"{key}.mean_error", float(off.mean()), each[0].ours.dimension.unit),
            Metric(f"{key}.in_sigma", _rms(off / sigma)),
        ]
    share, (low, high) = 100 * float(np.mean(of_all)), binomial(sum(of_all), len(of_all))
    return [
        Metric("parts.coverage", share, "%", "higher", _LEAST, floor=2.0),
        Metric("parts.coverage_not_too_high", share, "%", "lower", _MOST, floor=2.0),
        Metric("parts.surely_outside", outside, "", "lower", 0),
        Metric("parts.coverage_low", 100 * low, "%"),
        Metric("parts.coverage_high", 100 * high, "%"),
        *metrics,
    ]


def ratios(kind: str, found: Found) -> list[Metric]:
    """RMS errors over the peer's: of each dimension, in the median of all, and in that of round shapes."""
    shares = {
        name: _rms(np.array([one.off for one in each])) / _rms(np.array([one.peer_off for one in each]))
        for name, each in found.items()
        if np.isfinite(each[0].peer_off)
    }
    of_round = [share for name, share in shares.items() if found[name][0].ours.dimension.kind in _ROUND]
    return [
        Metric(f"parts.{kind}.over_peer", float(np.median(list(shares.values()))), "", "lower", _OF_PEER, 0.2),
        *(
            [Metric(f"parts.{kind}.round.over_peer", float(np.median(of_round)), "", "lower", _OF_PEER, 0.2)]
            if of_round
            else []
        ),
        *(Metric(f"parts.{kind}.{name.replace(' ', '_')}.over_peer", share) for name, share in shares.items()),
    ]


def _rms(off: np.ndarray) -> float:
    return float(np.sqrt((off**2).mean()))
