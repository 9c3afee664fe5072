"""A photograph that does not go with those beside it is named, and one without a stripe among those with one."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.reconstruction.odd_frames import frame_names
from jaxscan.reconstruction.order_watch import OrderWatch
from jaxscan.rig import Fixed
from jaxscan.simulation import rig_2003, shapes
from jaxscan.simulation.profile import true_profile
from tests.reconstruction.test_order_watch import LINES, stripes

NAMES = [f"{i:03d}.png" for i in range(160)]


def notes(pixels: np.ndarray, **positions: np.ndarray) -> list[str]:
    watch = OrderWatch(Fixed())
    positions = positions or {"turntable": 20 * np.arange(len(pixels))}
    for first in range(0, len(pixels), 16):
        watch.see(pixels[first : first + 16], {axis: q[first : first + 16] for axis, q in positions.items()})
    return watch.notes(NAMES[: len(pixels)])


@pytest.mark.parametrize("by", [-110.0, 9.0])
@pytest.mark.parametrize("which", [1, 25, 58])
def test_a_photograph_far_from_both_its_neighbours_is_named(by, which):
    seen = stripes(60, height_px=5)
    assert notes(seen) == []
    seen[which] += by
    (note,) = notes(seen)
    assert note.startswith(f"the stripe of {which:03d}.png ({abs(by):.0f} px from theirs) does not fit those ")
    # Those beside it in the order of the steps count, whatever the files' order; where nothing has steps, the files'.
    assert NAMES[59 - which] in notes(seen[::-1], turntable=np.arange(60)[::-1])[0]
    assert NAMES[which] in notes(seen, turntable=np.zeros(60, int))[0]
    assert OrderWatch(Fixed()).notes(NAMES) == []


def test_what_an_object_does_is_not_odd():
    seen = stripes(60, height_px=5)
    rib, jagged, edge, thin = seen.copy(), seen.copy(), seen.copy(), seen.copy()
    # A rib or an arm beside which the table shows; a comb; an edge; a photograph that shows little.
    rib[30, LINES > 100] += 50
    jagged[::7] += 50
    edge[30:] += 50
    thin[30] = np.where(LINES < 200, seen[30] + 50, np.nan)
    for each in (rib, jagged, edge, thin):
        assert notes(each) == []


@pytest.mark.parametrize(("name", "apart"), [("stair", 4000), ("figure", 4000), ("figure", 80)])
def test_scans_of_objects_have_no_odd_photograph(name, apart):
    plain = rig_2003.simulated_rig(0)
    rig = plain if apart > 100 else rig_2003.with_turntable(plain, 0)
    steps = {"stage": tuple(range(0, 72_000, apart))} if apart > 100 else rig_2003.turning_axes(apart)
    bodies = getattr(shapes, name)(rig_2003.OBJECT_Y)
    scene = rig_2003.scan_scene(rig, bodies if isinstance(bodies, tuple) else (bodies,))
    places = [dict(zip(steps, place, strict=True)) for place in zip(*steps.values(), strict=True)]
    seen = np.stack([true_profile(rig, scene, q, lighting=rig_2003.SCAN_LIGHTING).position for q in places])
    assert notes(seen, **{axis: np.asarray(n) for axis, n in steps.items()}) == []


def test_photographs_without_a_stripe_are_named():
    seen = stripes(60, height_px=5)
    seen[:3] = seen[57:] = np.nan
    assert notes(seen) == []
    seen[20] = np.nan
    assert notes(seen) == [
        "020.png shows no stripe, and those before and after do: check that the laser was on; if its light met "
        "nothing there, nothing is wrong"
    ]
    seen[30:34] = seen[40] = np.nan
    (note,) = notes(seen)
    assert note.startswith("020.png, 030.png, 031.png, 032.png and 2 more show no stripe")
    # Behind a gap another object begins.
    seen[:] = stripes(60, height_px=5)
    seen[30:34] = np.nan
    seen[34:] += 100
    assert notes(seen) == []


def test_frames_are_called_by_their_files():
    files = tuple(Path(f"{i}.png") for i in range(4))
    scan = Scan(Path("scan.toml"), StripeSettings(), files, axes={"stage": (0, 0, 5, 5)})
    assert frame_names(scan, 4) == ["0.png", "1.png", "2.png", "3.png"]
    several = Scan(scan.path, scan.laser, files, axes=scan.axes, exposures_s=(0.1, 0.2, 0.1, 0.2))
    assert frame_names(several, 2) == ["0.png", "2.png"]
    assert frame_names(Scan(scan.path, scan.laser), 2) == ["frame 0", "frame 1"]
