"""Throughput against limits measured in the same run: the kernel, detection, a scan from files to points, memory.

The limit of the kernel is a copy, by two threads, of as many points as it writes; of detection, reading every
byte of the images once; of a scan, decoding its photographs.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, UInt

from benchmarks.bare import bare_stripe
from benchmarks.metric import Metric, ratio
from benchmarks.timing import side_by_side
from jaxscan.detectors import DEFAULT, DETECTORS, Detector
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan, read_scan
from jaxscan.images import StripeSettings, detect_stripe, read_image
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel, Scanner
from jaxscan.reconstruction.frames import aligned
from jaxscan.reconstruction.triangulate import FramePoses, triangulate_into
from jaxscan.rig import Camera, Chain, Covariance, Light, LightPlane, Linear, Motion, Rig, Rotary
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation.render import plane_of

_LENSES = {"radial1": ((-0.134,), ()), "brown": ((-0.27, 0.05, 0.1), (1e-3, -2e-3))}
# Which detectors a scan is measured with: the default, and the quickest.
OF_A_SCAN: tuple[Detector, ...] = (DEFAULT, "derivative")
# Which of them are to keep up with reading, and which are timed in the short form.
CLOSED: tuple[Detector, ...] = ("gravity", "derivative")
OF_A_READ = (*CLOSED, DEFAULT)
_ROWS, _COLUMNS = 1080, 1920
# Of each frame that the kernel is timed with.
_LINES = 1000


def measure(quick: bool) -> list[Metric]:
    """All figures; in the short form one size of each, and no memory."""
    metrics = kernel(quick) + ([] if quick else moving())
    for rows, columns in ((480, 640),) if quick else ((480, 640), (_ROWS, _COLUMNS)):
        metrics += detection(rows, columns, OF_A_READ if quick else tuple(DETECTORS), repeats=7 if quick else 15)
    with tempfile.TemporaryDirectory() as folder:
        metrics += end_to_end(Path(folder), 32 if quick else 200, repeats=3 if quick else 5, plain=not quick)
    return metrics if quick else metrics + memory()


def rig(columns: int, rows: int, lens: str = "radial1", motion: Motion | None = None) -> Rig:
    """The rig of 2003, its image scaled, with another motion than its stage if one is given."""
    scale = columns / 640
    with float64():
        focal, principal = (697.7 * scale, 690.4 * scale), ((columns - 1) / 2, (rows - 1) / 2)
        camera = Camera.create((columns, rows), focal, principal, lens, *_LENSES[lens])
        stage = Linear.create([0.0, 9e-4, -4e-4]) if motion is None else motion
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),), stage))


def kernel(quick: bool) -> list[Metric]:
    """Triangulation from prepared buffers into a buffer that is used again and again."""
    metrics = []
    cases = [("float32", "radial1", 0.75 if n < 3e7 else 0.55, n) for n in (10**6, 10**7, 5 * 10**7)]
    cases += [("float32", "brown", 0.45, 10**6), ("float64", "radial1", 0.6, 10**6)]
    for dtype, lens, goal, count in cases[:1] if quick else cases:
        with jax.enable_x64(dtype == "float64"):
            once = triangulation(random_pixels(count, dtype), lens)
            source = np.ones(3 * count, dtype)
            target = np.ones(3 * count, dtype)

            halves = list(zip(np.array_split(source, 2), np.array_split(target, 2), strict=True))
            with ThreadPoolExecutor(2) as pool:

                def copy(pool: ThreadPoolExecutor = pool, halves: list = halves) -> None:
                    list(pool.map(lambda pair: np.copyto(pair[1], pair[0]), halves))

                once()
                copied, took = side_by_side(copy, once, 21 if count < 10**7 else 9)
        name = f"throughput.kernel.{dtype}.{lens}.{power_of_ten(count)}"
        rate = 2 * source.nbytes / copied / 1e9
        print(f"  {name}: {took / count * 1e9:.2f} ns a point; the copy moves {rate:.1f} GB/s", flush=True)
        metrics.append(Metric(name, copied / took, "of a copy", "higher", goal, slack=1.0, target_suffices=True))
    return metrics


def moving() -> list[Metric]:
    """The rate of the kernel where the load turns, or turns on a stage, or the light moves, over that of a stage."""
    with float64():
        table = Rotary.create([0.0, 2e-3, 1e-4], [3.0, 4.0, 300.0])
        chain = Chain((Linear.create([0.0, 9e-4, -4e-4]), table))
    return [
        *kernel_beside_the_plain("throughput.kernel.rotary", "a stage's", 0.95, motion=table),
        *kernel_beside_the_plain("throughput.kernel.chain", "a stage's", 0.95, motion=chain),
        *kernel_beside_the_plain("throughput.kernel.swept", "a stage's", 0.9, swept=True),
    ]


def kernel_beside_the_plain(stem: str, of: str, goal: float, quick: bool = False, **other: Any) -> list[Metric]:
    """The kernel's rate, with other parts as `triangulation` takes them, over that of stage, plane and upright sensor.

    Args:
        stem: of the figures' names.
        of: whose rate it is compared with, in words.
        goal: of the ratio.
        quick: a million points alone, not ten millions too.
        other: the parts.
    """
    metrics = []
    for count in (10**6,) if quick else (10**6, 10**7):
        pixels = random_pixels(count, "float32")
        once, one_more = triangulation(pixels, "radial1"), triangulation(pixels, "radial1", **other)
        once()
        one_more()
        plain, took = side_by_side(once, one_more, 41 if count < 10**7 else 15)
        figure = f"{stem}.{power_of_ten(count)}"
        print(f"  {figure}: {took / count * 1e9:.2f} ns a point; {of} {plain / count * 1e9:.2f}", flush=True)
        metrics.append(Metric(figure, plain / took, f"of {of}", "higher", goal, slack=1.0, target_suffices=True))
    return metrics


def random_pixels(count: int, dtype: str) -> list[Float[np.ndarray, "frames lines"]]:
    """U and v of stripe points anywhere in photographs of a thousand lines."""
    random = np.random.default_rng(0)
    return [random.uniform(0, top, (count // _LINES, _LINES)).astype(dtype) for top in (639, 479)]


def triangulation(
    pixels: Sequence[Float[np.ndarray, "frames lines"]],
    lens: str,
    motion: Motion | None = None,
    swept: bool = False,
    light: Light | None = None,
    tilt: tuple[float, ...] = (),
    camera: Camera | None = None,
) -> Callable[[], jax.Array]:
    """What triangulates pixels that are on the device, into a buffer there that is used again and again.

    With a light that is swept, each frame has a plane of its own; another light takes the place of the rig's. The
    sensor may be tilted, rad; another camera takes the place of the rig's.
    """
    dtype = pixels[0].dtype.name
    whole, n_frames = rig(640, 480, lens, motion), len(pixels[0])
    whole = replace(whole, camera=replace(whole.camera, tilt=tilt))
    if camera is not None:
        whole = replace(whole, camera=camera)
    if light is not None:
        whole = Rig(whole.camera, (as_numpy(light),), whole.motion)
    ready, inputs = Kernel.create(whole, dtype=dtype), [jnp.asarray(x) for x in pixels]
    if swept:
        c = np.linspace(0.0025, 0.0035, n_frames)
        ready = ready.with_lights(LightPlane((0 * c, 0 * c - 0.00494, c)))
    positions = {axis: np.linspace(0, 7e4, n_frames) for axis in whole.axes()}
    frames = FramePoses.create(whole.motion, positions, n_frames, dtype)
    points = jnp.zeros((*pixels[0].shape, 3), dtype)

    def once() -> jax.Array:
        nonlocal points
        points = jax.block_until_ready(triangulate_into(points, ready, frames, *inputs))
        return points

    return once


def power_of_ten(count: int) -> str:
    """1e6 of a million, as a figure's name has it."""
    return f"{count:.0e}".replace("+0", "")


def detection(rows: int, columns: int, names: Sequence[Detector], repeats: int) -> list[Metric]:
    """Sixteen colour frames in memory to stripes, against reading every byte once by two threads."""
    frames = sixteen_frames(rows, columns)
    words = np.array_split(frames.reshape(-1).view(np.uint64), 2)

    def detect(name: Detector) -> Float[np.ndarray, "frames columns"]:
        return detect_stripe(frames, StripeSettings("red"), detector=name).position

    metrics = []
    for name, work in {"bare": partial(bare_stripe, frames), **{n: partial(detect, n) for n in names}}.items():
        off = work() - stripe_centre(rows, np.arange(columns), 0.0)
        print(f"  {columns} x {rows}, {name}: RMS {np.sqrt(np.mean(off**2)):.4f} px of the drawn stripe", flush=True)
        with ThreadPoolExecutor(2) as pool:

            def read(pool: ThreadPoolExecutor = pool) -> None:
                list(pool.map(np.bitwise_or.reduce, words))

            limit, took = side_by_side(read, work, repeats)
        goal = None if name not in CLOSED else 0.5 if columns > 1000 else 0.35
        label = f"throughput.detect.{columns}.{name}"
        # Small images are read in less time than threads take to begin: that ratio differs by 1.8 from run to run.
        better = "shown" if name == "bare" or columns < 1000 else "higher"
        metrics.append(Metric(label, limit / took, "of a read", better, goal, slack=1.0, target_suffices=True))
        if name != "bare":
            bare, took = side_by_side(partial(bare_stripe, frames), work, repeats)
            metrics.append(Metric(f"{label}.over_bare", took / bare, "", "lower", slack=1.0))
        metrics.append(Metric(f"{label}.ns_a_column", took / (16 * columns) * 1e9, "ns"))
    return metrics


def end_to_end(folder: Path, count: int, repeats: int, plain: bool) -> list[Metric]:
    """JPEGs to points, against decoding them alone, and against a plain loop over OpenCV and NumPy.

    The plain loop is slow, and says nothing when it is timed once.
    """
    scan = _scan(folder, count)
    content = _content()
    buffer = aligned((16, _ROWS, _COLUMNS, 3), np.uint8)

    def decode() -> None:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(lambda i: read_image(scan.frames[i], buffer[i % 16]), range(count)))

    metrics = []
    for name in OF_A_SCAN:
        begin = time.perf_counter()
        scanner = Scanner(content, name)
        points = sum(int(part.valid.sum()) for part in scanner.scan(scan))
        first = time.perf_counter() - begin

        def whole(scanner: Scanner = scanner) -> None:
            for _ in scanner.scan(scan):
                pass

        limit, took = side_by_side(decode, whole, repeats)
        label = f"throughput.scan.{name}"
        print(
            f"  {label}: {points} points, {count / took:.0f} frames/s, decoding alone {count / limit:.0f}", flush=True
        )
        print(f"  {label}: the first time, compilation and all, {first:.1f} s", flush=True)
        metrics.append(ratio(f"{label}.over_decoding", took / limit, 1.15))
        if plain:
            slow, took = side_by_side(lambda: _plain(scan, content.rig), whole, 3)
            metrics.append(ratio(f"{label}.times_a_plain_loop", slow / took, 4.5, "higher"))
            thick = Scanner(replace(content, fit={**content.fit, "sheet_sigma_mm": [0.25]}), name)
            list(thick.scan(scan))
            thin, took = side_by_side(whole, partial(whole, thick), repeats)
            metrics.append(ratio(f"{label}.thick_sheet_over_thin", took / thin, 1.15))
    return metrics


def memory() -> list[Metric]:
    """Peak of a process that reconstructs 200 frames and of one that does 5000, to a PLY file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _scan(folder, 20, 480, 640)
        from jaxscan.files.rig_file import write_rig

        write_rig(folder / "rig.json", _content(640, 480))
        peaks = []
        for count in (200, 5000):
            of = folder / str(count)
            of.mkdir()
            for i in range(count):
                os.link(folder / "frames" / f"{i % 20:04d}.jpg", of / f"{i:04d}.jpg")
            (of / "scan.toml").write_text('[scan]\nframes = "*.jpg"\nsteps_per_frame = 10\n')
            # Its own peak: that which getrusage tells is no less than what the process had that started it.
            code = (
                "import re, sys; from pathlib import Path; from jaxscan.cli.main import main; "
                "status = main(sys.argv[1:]); "
                "print(re.search(r'VmHWM:\\s*(\\d+)', Path('/proc/self/status').read_text())[1]); sys.exit(status)"
            )
            command = ["reconstruct", str(of), "--rig", str(folder / "rig.json"), "-o", str(of / "out.ply")]
            run = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=True)
            peaks.append(int(run.stdout.split()[-1]) / 1024)
        print(f"  peak memory: {peaks[0]:.0f} MiB for 200 frames, {peaks[1]:.0f} for 5000", flush=True)
    return [Metric("throughput.memory.5000_over_200", peaks[1] / peaks[0], "", "lower", 1.2, slack=0.1)]


def _content(columns: int = _COLUMNS, rows: int = _ROWS) -> RigFile:
    own = rig(columns, rows)
    names = tuple(parameter_names(own))
    return RigFile(own, Covariance(names, np.diag(np.full(len(names), 1e-10))))


def _scan(folder: Path, count: int, rows: int = _ROWS, columns: int = _COLUMNS) -> Scan:
    """A scan of JPEGs with a stripe that wanders."""
    (folder / "frames").mkdir(exist_ok=True)
    v, u = np.mgrid[:rows, :columns]
    random = np.random.default_rng(0)
    ground = (40 + 20 * np.sin(u / 70) + 20 * np.cos(v / 50))[..., None] + 2 * random.standard_normal(
        (rows, columns, 3)
    )
    ground = ground.clip(0, 255).astype(np.uint8)
    for i in range(count):
        frame = np.roll(ground, 7 * i, axis=0)[None].copy()
        _draw(frame, np.array([i / 10]))
        quality = [cv2.IMWRITE_JPEG_QUALITY, 92]
        cv2.imwrite(str(folder / "frames" / f"{i:04d}.jpg"), frame[0, ..., ::-1], quality)
    (folder / "scan.toml").write_text('[scan]\nframes = "frames/*.jpg"\nsteps_per_frame = 200\n')
    return read_scan(folder)


def sixteen_frames(rows: int, columns: int) -> UInt[np.ndarray, "16 rows columns 3"]:
    """Noise, and a red stripe across it; in memory from which a compiled function takes them as they are."""
    frames = aligned((16, rows, columns, 3), np.uint8)
    frames[:] = np.random.default_rng(0).integers(0, 40, frames.shape, dtype=np.uint8)
    _draw(frames, np.zeros(16))
    return frames


def _draw(frames: UInt[np.ndarray, "frames rows columns 3"], phases: Float[np.ndarray, "frames"]) -> None:
    """A red stripe of σ 1.5 px across each frame."""
    _, rows, columns, _ = frames.shape
    u = np.arange(columns)
    for frame, phase in zip(frames, phases, strict=True):
        centre = stripe_centre(rows, u, phase)
        for k in range(-6, 7):
            row = np.floor(centre).astype(int) + k
            level = frame[row, u, 0] + 190 * np.exp(-0.5 * ((row - centre) / 1.5) ** 2)
            frame[row, u, 0] = level.clip(0, 255).astype(np.uint8)


def stripe_centre(rows: int, u: Int[np.ndarray, "columns"], phase: float) -> Float[np.ndarray, "columns"]:
    """Where that stripe runs, px."""
    return 0.55 * rows + rows / 18 * np.sin(u / 200 + phase)


def _plain(scan: Scan, rig: Rig) -> None:
    """What one would write in an afternoon: OpenCV reads, NumPy finds the centre of gravity, frame after frame."""
    camera, plane = rig.camera, plane_of(rig.lights[0])
    (fu, fv), (u0, v0) = camera.focal, camera.principal
    matrix = np.array([[fu, 0, u0], [0, fv, v0], [0, 0, 1]], np.float64)
    lens = np.array([float(jax.tree.leaves(camera.lens)[0]), 0, 0, 0])
    rows = np.arange(_ROWS, dtype=np.float32)[:, None]
    for path in scan.frames:
        image = np.asarray(cv2.imread(str(path)), np.float32)
        red = 2 * image[..., 2] - image[..., 1] - image[..., 0]
        weight = np.where(red > 0.5 * red.max(axis=0), red, 0)
        v = (weight * rows).sum(axis=0) / weight.sum(axis=0)
        pixels = np.stack([np.arange(_COLUMNS), v], axis=-1).astype(np.float64)
        x = cv2.undistortPoints(pixels[:, None], matrix, lens)[:, 0]
        ray = np.column_stack([x, np.ones(len(x))])
        _ = ray / (ray @ plane)[:, None]
