"""The hot path on whatever device JAX finds, a GPU where there is one: transfer and work apart.

The limits are the device's own: of detection, reading every byte of frames that lie there once; of the kernel, copying
as many points as it writes. The way there and back is timed by itself: it tells what a GPU does for frames
that are there already, and what for those that come from files.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.metric import Metric
from benchmarks.throughput import OF_A_READ, power_of_ten, random_pixels, sixteen_frames, triangulation
from benchmarks.timing import side_by_side, timed
from jaxscan.detectors import DETECTORS, Detector
from jaxscan.files.rig_file import read_rig
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import read_range_image

_LONGEST_S: Final = 600.0


def measure(quick: bool) -> list[Metric]:
    """Transfer, detection and triangulation; in the short form one size of each."""
    device = jax.devices()[0]
    print(f"  device: {device.device_kind} ({device.platform}), JAX {jax.__version__}", flush=True)
    metrics, repeats = [], 3 if quick else 15
    for rows, columns in ((480, 640),) if quick else ((480, 640), (1080, 1920)):
        metrics += detection(device, rows, columns, OF_A_READ if quick else tuple(DETECTORS), repeats)
    for count in (10**6,) if quick else (10**6, 10**7, 5 * 10**7):
        metrics += kernel(device, count, repeats)
    return metrics if quick else metrics + alike(device)


def alike(device: Any) -> list[Metric]:
    """How far what the device computes of the simulated world is from what the processor computes."""
    with TemporaryDirectory() as name:
        folder, found = Path(name), []
        _jaxscan("cpu", "simulate", folder, "--object", "cup")
        for i, platform in enumerate(("cpu", device.platform)):
            rig, points = folder / f"{i}.json", folder / f"{i}.npz"
            took = _jaxscan(platform, "calibrate", folder / "session", "-o", rig)
            print(f"  calibrate, {platform}: {took:.0f} s with the program's start", flush=True)
            # With one rig, so that points differ by what is computed of them.
            _jaxscan(platform, "reconstruct", folder / "scan", "--rig", folder / "0.json", "-o", points)
            found.append((_numbers(rig), read_range_image(points)))
    (rig, here), (its_rig, there) = found
    both = here.valid & there.valid
    apart = {
        "lines_unlike": float((here.valid != there.valid).mean()),
        "pixels_px": _largest(here.pixels, there.pixels, both),
        "points_mm": _largest(here.points, there.points, both),
        "sigma_relative": _largest(there.sigma / here.sigma, np.ones(both.shape), both),
        "rig_relative": float((np.abs(its_rig - rig) / np.maximum(np.abs(rig), 1e-9)).max()),
    }
    for what, by in apart.items():
        print(f"  {what}: {by:.2g}", flush=True)
    return [Metric(f"device.{device.platform}.alike.{what}", by) for what, by in apart.items()]


def _jaxscan(platform: str, *words: object) -> float:
    """Run a command on the processor or on JAX's own choice; the seconds it takes."""
    begun = perf_counter()
    subprocess.run(
        [sys.executable, "-m", "jaxscan", *map(str, words)],
        check=True,
        stdout=subprocess.DEVNULL,
        # This program has most of a GPU's memory: the other takes what it needs.
        env=os.environ
        | ({"JAX_PLATFORMS": "cpu"} if platform == "cpu" else {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}),
        timeout=_LONGEST_S,
    )
    return perf_counter() - begun


def _numbers(rig: Path) -> Float[np.ndarray, "n"]:
    """Camera and lights of a rig's file."""
    with float64():
        leaves = jax.tree.leaves(as_float64(read_rig(rig).rig))
    return np.concatenate([np.ravel(np.asarray(x, np.float64)) for x in leaves])


def _largest(one: np.ndarray, other: np.ndarray, where: np.ndarray) -> float:
    return float(np.abs(one[where].astype(np.float64) - other[where]).max())


def detection(device: Any, rows: int, columns: int, names: Sequence[Detector], repeats: int) -> list[Metric]:
    """Sixteen colour frames: to the device, and to stripes once they are there."""
    frames, settings = sixteen_frames(rows, columns), StripeSettings("red")
    name = f"device.{device.platform}.{columns}"

    def send() -> jax.Array:
        return jax.block_until_ready(jax.device_put(frames, device))

    metrics = _transfer(f"{name}.to_device", frames.nbytes, send, repeats)
    there = send()
    read_once = jax.jit(lambda images: images.max())
    for detector in names:

        def detect(detector: Detector = detector) -> None:
            detect_stripe(there, settings, detector=detector)

        first = timed(detect, 1).first
        limit, took = side_by_side(lambda: jax.block_until_ready(read_once(there)), detect, repeats)
        print(f"  {name}.{detector}: {took * 1e3:.2f} ms for 16 frames; the first time {first:.1f} s", flush=True)
        metrics.append(Metric(f"{name}.{detector}.ns_a_column", took / (16 * columns) * 1e9, "ns"))
        metrics.append(Metric(f"{name}.{detector}.of_a_read", limit / took))
    return metrics


def kernel(device: Any, count: int, repeats: int) -> list[Metric]:
    """Triangulation of pixels that are on the device, into a buffer there; and both ways between."""
    name = f"device.{device.platform}.kernel.{power_of_ten(count)}"
    pixels = random_pixels(count, "float32")

    def send() -> list[jax.Array]:
        return jax.block_until_ready(jax.device_put(pixels, device))

    with jax.default_device(device):
        once = triangulation(pixels, "radial1")
        numbers, copied = jnp.ones(3 * count), jnp.zeros(3 * count)

    def copy() -> None:
        nonlocal copied
        copied = jax.block_until_ready(_negative_into(copied, numbers))

    copy()
    once()
    limit, took = side_by_side(copy, once, repeats)
    points = once()
    print(f"  {name}: {took / count * 1e9:.3f} ns a point; the copy {24e-9 * count / limit:.0f} GB/s", flush=True)
    return [
        Metric(f"{name}.of_a_copy", limit / took),
        *_transfer(f"{name}.to_device", 8 * count, send, repeats),
        # A fetched array is kept with the one on the device: each time one that was not fetched before.
        *_transfer(f"{name}.to_host", 12 * count, lambda: np.array(jnp.copy(points)), repeats),
    ]


@partial(jax.jit, donate_argnums=0, keep_unused=True)
def _negative_into(out: Float[Array, "n"], x: Float[Array, "n"]) -> Float[Array, "n"]:
    """A copy that no compiler leaves out."""
    return -x


def _transfer(name: str, size: int, work: Callable[[], object], repeats: int) -> list[Metric]:
    seconds = timed(work, repeats).median
    return [Metric(f"{name}.ms", seconds * 1e3, "ms"), Metric(f"{name}.rate", size / seconds / 1e9, "GB/s")]
