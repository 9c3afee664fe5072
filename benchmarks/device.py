"""The hot path on whatever device JAX finds, a GPU where there is one: transfer and work apart.

The limits are the device's own: of detection, reading every byte of frames that lie there once; of the kernel, copying
as many points as it writes. The way there and back is timed by itself: it tells what a GPU does for frames
that are there already, and what for those that come from files.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.metric import Metric
from benchmarks.throughput import OF_A_READ, power_of_ten, random_pixels, sixteen_frames, triangulation
from benchmarks.timing import side_by_side, timed
from jaxscan.detectors import DETECTORS, Detector
from jaxscan.images import StripeSettings, detect_stripe


def measure(quick: bool) -> list[Metric]:
    """Transfer, detection and triangulation; in the short form one size of each."""
    device = jax.devices()[0]
    print(f"  device: {device.device_kind} ({device.platform}), JAX {jax.__version__}", flush=True)
    metrics, repeats = [], 3 if quick else 15
    for rows, columns in ((480, 640),) if quick else ((480, 640), (1080, 1920)):
        metrics += detection(device, rows, columns, OF_A_READ if quick else tuple(DETECTORS), repeats)
    for count in (10**6,) if quick else (10**6, 10**7, 5 * 10**7):
        metrics += kernel(device, count, repeats)
    return metrics


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
