"""Sides that are joined rightly, and those of which one stands where another has seen through."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.merge import turned
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.surface.free_space import check_free_space
from jaxscan.surface.side import Side, side_of_image

STEPS = np.arange(0, 72001, 2000)


@pytest.fixture(scope="module")
def scanned() -> tuple[list[Side], list[Pose]]:
    """The figure from every second of its sides, with the floor that it stands on."""
    rig = rig_2003.simulated_rig(5)
    scenes, poses = turned(rig)
    images = [drawn_scan(rig, scene, {"stage": STEPS}, 0.03, k).image for k, scene in enumerate(scenes[::2])]
    return [side_of_image(f"side {k}", image) for k, image in enumerate(images)], poses[::2]


def test_sides_in_their_places_are_not_refused(scanned) -> None:
    check_free_space(*scanned)
    sides, poses = scanned
    # Nor where the poses are off by what a registration may be, and all of them by anything.
    off = Pose(np.zeros(3), np.array([0.2, -0.1, 0.15]))
    check_free_space(sides, [poses[0], *(off @ pose for pose in poses[1:])])
    check_free_space([replace(side, rays=None) for side in sides], poses[::-1])


def test_exchanged_sides_are_refused_and_named(scanned) -> None:
    sides, poses = scanned
    order = [0, 2, 1, *range(3, len(poses))]
    with pytest.raises(InputError, match=r"side \d: \d+% of its points would lie where side \d has seen through"):
        check_free_space(sides, [poses[k] for k in order])
