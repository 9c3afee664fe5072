"""What is packed and reckoned between solves compiles nothing: every session has other shapes."""

import jax

from jaxscan.calibration.blocks import sequence_blocks, view_blocks
from jaxscan.calibration.residuals import Noise, far_away
from jaxscan.precision import as_numpy, float64
from tests.calibration import synthetic


def test_packing_compiles_nothing():
    compiled = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append((kwargs, duration_secs))

    session = synthetic.observations(seed=0, n_views=13, n_stage=5)
    with float64():
        jax.monitoring.register_event_duration_secs_listener(listen)
        try:
            groups = view_blocks(session), sequence_blocks(session)
            as_numpy((groups, far_away(17), Noise.create(0.05, 0.1)))
        finally:
            jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled
    assert groups[0].corners.shape == (14, 1, 54, 2)
