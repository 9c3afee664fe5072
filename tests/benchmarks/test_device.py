"""The GPU's part of the benchmarks, on a CPU: it runs, and frames that lie on a device stay there."""

import jax
import numpy as np

from benchmarks import device
from benchmarks.throughput import sixteen_frames, stripe_centre
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes import detect


def test_transfer_and_work_are_figures_of_their_own():
    here = jax.devices()[0]
    figures = {
        m.name: m.value for m in (*device.detection(here, 64, 96, ("gravity",), 1), *device.kernel(here, 1000, 1))
    }
    assert all(value > 0 for value in figures.values())
    for name in ("96.to_device.ms", "96.gravity.of_a_read", "kernel.1e3.of_a_copy", "kernel.1e3.to_host.rate"):
        assert f"device.cpu.{name}" in figures


def test_of_frames_on_a_device_only_a_few_pixels_are_fetched(monkeypatch):
    frames = sixteen_frames(64, 96)
    fetched = []

    as_array = np.asarray

    def noted(x, *args, **kwargs):
        if isinstance(x, jax.Array):
            fetched.append(x.nbytes)
        return as_array(x, *args, **kwargs)

    monkeypatch.setattr(detect.np, "asarray", noted)
    found = detect_stripe(jax.device_put(frames), StripeSettings("red"), detector="gravity")
    assert fetched
    assert max(fetched) < frames.nbytes / 2
    off = found.position - stripe_centre(64, np.arange(96), 0.0)
    assert np.sqrt(np.nanmean(off**2)) < 0.2
    np.testing.assert_array_equal(
        found.position, detect_stripe(frames, StripeSettings("red"), detector="gravity").position
    )
