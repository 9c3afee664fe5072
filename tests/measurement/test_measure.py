"""Dimensions of a drawn part: values, intervals of noise and of the rig, verdicts, and what cannot be measured."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
import trimesh

from benchmarks.measured_parts import (
    OWN_PX,
    SIGMA_PX,
    SPECKLE_PX,
    Scene,
    as_image,
    at,
    blocks_and_balls,
    drawn_rig,
    implicit,
    looked_at,
    scan,
)
from jaxscan.errors import InputError
from jaxscan.files.part_file import Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.files.rig_file import RigFile
from jaxscan.measurement.measure import measure
from jaxscan.measurement.scanned import scanned_image, scanned_points
from jaxscan.measurement.section import outline
from jaxscan.measurement.verdict import verdict
from jaxscan.rig import Covariance
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003

RIG = rig_2003.simulated_rig(0)
SIGMAS = (0.2, 0.2, 0.1, 0.1, 4e-4, 5e-7, 1e-6, 1e-6, 1e-7, 1e-7, 2e-7)
KNOWN = RigFile(RIG, Covariance(tuple(parameter_names(RIG)), np.diag(np.square(SIGMAS))))
Y, STEPS = 12.0, np.arange(2000.0, 22000.0, 500.0)
TRUTH = {"radius": 9.0, "step": 4.0, "distance": float(np.hypot(40, 1)), "angle": 0.0}


def level(x):
    """A dome of 9 mm radius, a step of 4 mm, and a floor."""
    ball = np.linalg.norm(x - np.array([-30.0, Y, 3.0]), axis=1) - 9.0
    step = np.maximum(x[:, 2] - 4.0, 20.0 - x[:, 0])
    return np.minimum(np.minimum(ball, step), x[:, 2])


def around(x, z, radius):
    return Region(at(x, Y, z), None, radius)


PART = Part(
    Path("part.toml"),
    "drawn",
    (
        Feature("ball", "ball", around(-30.0, 5.0, 8.5)),
        Feature("low", "plane", around(10.0, 0.0, 8.0)),
        Feature("high", "plane", around(30.0, 4.0, 8.0)),
        Feature("cut", "section", around(30.0, 4.0, 9.0), point=at(0.0, Y, 0.0), normal=(0.0, 0.9, -0.42)),
        Feature("line", "line", of=("cut",)),
        Feature("none", "plane", around(0.0, 100.0, 3.0)),
    ),
    (
        Dimension("radius", "radius", ("ball",), 9.0, (-0.5, 0.5)),
        Dimension("step", "step", ("low", "high"), 4.0, (-0.001, 0.001)),
        Dimension("angle", "angle", ("low", "high")),
        Dimension("flatness", "flatness", ("high",), 0.0, (0.0, 1.0)),
        Dimension("line over low", "distance", ("line", "low")),
        Dimension("no distance", "distance", ("none", "ball"), 1.0, (-1.0, 1.0)),
    ),
)


@pytest.fixture(scope="module")
def scene():
    return Scene(implicit(level, STEPS), STEPS, PART, TRUTH)


@pytest.fixture(scope="module")
def near(scene):
    """What lies near the part's regions: nothing else is measured, and there are many drawings."""
    return looked_at(scene)


@pytest.fixture(scope="module")
def drawn(near):
    """Drawings with noise, and as many with next to none, which leaves the rig's part."""
    found = {}
    for share in (1.0, 1e-3):
        found[share] = []
        for seed in range(24):
            random = np.random.default_rng([5, seed])
            own = drawn_rig(random, KNOWN)
            found[share].append(measure(scanned_image(scan(near, own, random, share), own), PART))
    return found


@pytest.mark.parametrize("share", [1.0, 1e-3])
@pytest.mark.parametrize("name", ["radius", "step"])
def test_errors_are_as_large_as_is_said(drawn, share, name):
    each = [next(d for d in m.dimensions if d.dimension.name == name) for m in drawn[share]]
    # Without noise only the rig is left, and what the residuals of a detector do not show.
    off = np.array([(d.value - TRUTH[name]) / (d.sigma_rig if share < 1 else d.sigma) for d in each])
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.35
    assert np.mean([d.interval[0] <= TRUTH[name] <= d.interval[1] for d in each]) >= 0.85
    assert share < 1 or np.mean([d.sigma_rig / d.sigma for d in each]) < 0.5


def test_the_noise_of_a_small_ball_is_not_taken_for_larger(near):
    """Four numbers of 190 alike points take up less of the noise than four times what is alike."""
    features = (Feature("ball", "ball", around(-30.0, 10.0, 4.0)), *PART.features[1:3])
    part = replace(PART, features=features, dimensions=PART.dimensions[:2])
    scales = []
    for seed in range(48):
        random = np.random.default_rng([5, seed])
        own = drawn_rig(random, KNOWN)
        ball = measure(scanned_image(scan(near, own, random), own), part).features[0]
        assert ball.points < 200
        scales.append(ball.known.scale)
    assert np.sqrt(np.mean(np.square(scales))) == pytest.approx(np.hypot(OWN_PX, SPECKLE_PX) / SIGMA_PX, rel=0.05)


def test_smooth_errors_are_in_the_interval_where_residuals_show_them(scene, drawn):
    """Waves of 0.008 px over half a face; a pixel is worth about a millimetre and a half here."""

    def rest(m):
        step = next(d for d in m.dimensions if d.dimension.name == "step")
        return np.sqrt(step.sigma**2 - step.sigma_rig**2)

    smooth = []
    for m in drawn[1e-3]:
        assert rest(m) < 0.0005
    for seed in range(4):
        random = np.random.default_rng(seed)
        turn = random.uniform(0, 2 * np.pi, 2)
        frames, columns = np.meshgrid(*(np.arange(n) for n in scene.position.shape), indexing="ij")
        wave = 0.008 * (np.sin(columns / 15 + turn[0]) + np.sin(frames / 3 + turn[1]))
        image = as_image(scene.position + wave + 1e-3 * random.normal(size=wave.shape), STEPS, RIG)
        smooth.append(measure(scanned_image(image, KNOWN), PART))
    assert min(map(rest, smooth)) > 0.0015


@pytest.fixture(scope="module")
def sharp_and_blurred():
    """Scans with noise of 0.05 px, each column by itself: sharp, and with the last columns of balls and cylinders off.

    In the second the last three columns of each arc are seen too high, as light that spreads in the image has it.
    """
    both, whole = [], blocks_and_balls()
    R, origin = rig_2003.platform(RIG)
    x = (as_image(whole.position, whole.steps, RIG).points - origin) @ R
    with np.errstate(invalid="ignore"):
        round_ = (np.linalg.norm(x - np.array([-55.0, 30.0, 12.0]), axis=-1) < 12.1) & (x[..., 2] > 0.1)
        round_ |= (np.linalg.norm(x - np.array([-27.0, 30.0, 5.0]), axis=-1) < 5.1) & (x[..., 2] > 0.1)
    for off in (0.0, 1.0):
        rows = whole.position.copy()
        for frame, columns in enumerate(round_):
            start = np.flatnonzero(columns & ~np.roll(columns, 1))
            end = np.flatnonzero(columns & ~np.roll(columns, -1))
            for deep, by in enumerate((0.12, 0.05, 0.02)):
                rows[frame, start + deep] -= off * by
                rows[frame, end - deep] -= off * by
        noise = 0.05 * np.random.default_rng(1).normal(size=rows.shape)
        image = as_image(rows + noise, whole.steps, RIG)
        both.append(measure(scanned_image(image, KNOWN), whole.part))
    return both


def test_a_border_is_left_out_where_it_is_off(sharp_and_blurred):
    for k, radius in enumerate((12.0, 5.0)):
        sharp, blurred = (each.dimensions[k] for each in sharp_and_blurred)
        for each in (sharp, blurred):
            assert abs(each.value - radius) < each.uncertainty
        assert blurred.points < 0.97 * sharp.points
        assert blurred.sigma > 1.2 * sharp.sigma
        assert abs(blurred.value - sharp.value) < 2 * blurred.sigma


def test_a_sharp_scan_keeps_its_border(sharp_and_blurred):
    """So the balls are known from all of their points: twice as well as without the last three columns."""
    sharp, _ = sharp_and_blurred
    assert all(each.fit.blurred < 0.2 for each in sharp.features if each.fit is not None and each.feature.region)
    assert sharp.dimensions[0].points > 1400
    assert sharp.dimensions[1].points > 240


def test_what_more_points_do_not_improve_is_the_rigs_part(scene):
    random = np.random.default_rng(3)
    own = drawn_rig(random, KNOWN)
    image = scan(scene, own, random)
    fine, coarse = (measure(scanned_image(x, own), PART).dimensions[1] for x in (image, image[:, ::2]))
    assert coarse.points == pytest.approx(fine.points / 2, rel=0.1)
    assert coarse.sigma_rig == pytest.approx(fine.sigma_rig, rel=0.02)
    assert coarse.by_rig["lights.0.plane.2"] == pytest.approx(fine.by_rig["lights.0.plane.2"], rel=0.1)


def test_the_derivative_by_the_rig_is_that_of_another_rig(scene):
    """The step, measured with a rig of which one number is another."""
    found = measure(scanned_image(as_image(scene.position, STEPS, RIG), KNOWN), PART).dimensions[1]
    move = 3e-5
    other = eqx.tree_at(lambda rig: rig.lights[0].plane[2], RIG, np.asarray(RIG.lights[0].plane[2] + move))
    again = scanned_image(as_image(scene.position, STEPS, other), replace(KNOWN, rig=other))
    moved = measure(again, PART).dimensions[1]
    assert found.by_rig["lights.0.plane.2"] == pytest.approx((moved.value - found.value) / move, rel=0.03)


def test_verdicts_and_what_is_left_unmeasured(drawn):
    found = drawn[1.0][0]
    by_name = {d.dimension.name: d for d in found.dimensions}
    assert by_name["radius"].verdict == "conforming"
    assert by_name["step"].verdict == "not decided"
    assert by_name["flatness"].verdict == "conforming"
    lost = by_name["no distance"]
    assert lost.value is None
    assert lost.verdict == "not decided"
    assert '"none" was not measured: no point lies in its region' in lost.problem
    assert found.verdict == "not decided"
    assert len(found.problems) == 2
    assert by_name["line over low"].value == pytest.approx(4.0, abs=0.5)
    angle = by_name["angle"]
    assert angle.notes[-1] == "0° cannot be excluded: the interval says how large it is at most"
    assert angle.interval[0] == 0
    assert angle.interval[1] > angle.value + angle.sigma


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ((9.9, 10.1), "conforming"),
        ((9.8, 10.2), "conforming"),
        ((9.7, 10.1), "not decided"),
        ((10.3, 10.4), "not conforming"),
        ((9.0, 9.7), "not conforming"),
        ((9.0, 11.0), "not decided"),
        (None, "not decided"),
    ],
)
def test_guard_bands(interval, words):
    assert verdict(interval, (9.8, 10.2)) == words


def test_a_small_piece_of_a_ball_is_told(scene):
    own = drawn_rig(np.random.default_rng(1), KNOWN)
    image = scan(scene, own, np.random.default_rng(1))
    small = Feature("ball", "ball", around(-30.0, 12.0, 4.0))
    part = replace(PART, features=(small,), dimensions=PART.dimensions[:1])
    (radius,) = measure(scanned_image(image, own), part).dimensions
    assert "of the ball was seen" in radius.notes[0]
    whole = measure(scanned_image(image, own), PART).dimensions[0]
    assert radius.uncertainty > 4 * whole.uncertainty


def test_features_are_in_the_parts_order_also_where_one_is_not_found(scene):
    part = replace(PART, features=(PART.features[-1], *PART.features[:-1]))
    for each in (part, PART):
        found = measure(scanned_image(as_image(scene.position, STEPS, RIG), KNOWN), each)
        assert [one.feature.name for one in found.features] == [one.name for one in each.features]


def test_growing_goes_on_over_the_face(scene):
    own = drawn_rig(np.random.default_rng(1), KNOWN)
    image = scan(scene, own, np.random.default_rng(1))
    grown = Feature("high", "plane", around(30.0, 4.0, 5.0), grow=True)
    part = replace(PART, features=(grown,), dimensions=())
    (face,) = measure(scanned_image(image, own), part).features
    x = (image.points[image.valid].astype(float) - np.array(at(0, 0, 0))) @ rig_2003.platform(RIG)[0]
    inside = x[:, 0] > 20.0
    assert face.points == pytest.approx(inside.sum(), rel=0.02)


def test_without_a_rig_or_sigma_there_are_no_intervals_and_that_is_said(scene):
    image = as_image(scene.position, STEPS, RIG)
    for scanned, words in (
        (scanned_image(image), "no rig is given"),
        (scanned_image(image, RigFile(RIG)), "the rig has no covariance"),
        (scanned_points(image.points[image.valid]), "a cloud does not say how its points were made"),
    ):
        found = measure(scanned, PART)
        radius = found.dimensions[0]
        assert radius.value == pytest.approx(9.0, abs=2e-4)
        assert radius.interval is None
        assert radius.verdict == "not decided"
        assert words in found.notes[0]


def test_what_was_noted_of_the_scan_is_said_again(scene):
    image = replace(as_image(scene.position, STEPS, RIG), notes=("the photographs were denoised",))
    assert measure(scanned_image(image, KNOWN), PART).notes == ("the scan: the photographs were denoised",)


def test_a_section_lies_on_the_surface_between_its_points(scene):
    """Chords over frames 1 mm apart lie up to 0.014 mm inside of a dome of 9 mm."""
    image = as_image(scene.position[::2], STEPS[::2], RIG)
    R, origin = rig_2003.platform(RIG)
    y = tuple(R[:, 1].tolist())
    cut = Feature("cut", "section", around(-30.0, 5.0, 8.0), point=at(0.0, Y + 0.3, 0.0), normal=y)
    found = outline(scanned_image(image, KNOWN), cut)
    x = (found.points - origin) @ R
    np.testing.assert_allclose(x[:, 1], Y + 0.3, atol=2e-3)
    off = np.linalg.norm(x - np.array([-30.0, Y, 3.0]), axis=1) - 9.0
    on_dome = x[:, 2] > 1.5
    assert on_dome.sum() > 20
    assert np.abs(off[on_dome]).max() < 1e-3


def test_another_rig_is_refused(scene):
    image = as_image(scene.position, STEPS, RIG)
    other = rig_2003.simulated_rig(1)
    with pytest.raises(InputError, match="not where this rig would see the stripe"):
        scanned_image(image, replace(KNOWN, rig=other))


def test_a_profile_against_a_mesh(scene, tmp_path):
    image = as_image(scene.position, STEPS, RIG)
    R, origin = rig_2003.platform(RIG)
    box = trimesh.creation.box(bounds=[[20, -60, -10], [90, 90, 4]])
    box.apply_transform(np.block([[R, origin[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    box.export(tmp_path / "box.stl")
    surface = Feature("face", "surface", around(30.0, 4.0, 8.0))
    asked = Dimension("profile", "profile", ("face",), 0.0, (0.0, 0.1), tmp_path / "box.stl")
    part = replace(PART, features=(surface,), dimensions=(asked,))
    (profile,) = measure(scanned_image(image, KNOWN), part).dimensions
    assert profile.value < 1e-3
    assert profile.uncertainty > 0.001
    assert not any("holes" in note for note in profile.notes)
    opened = box.copy()
    # Without a side that the scan does not see.
    opened.update_faces(opened.face_normals @ R[:, 2] > -0.5)
    opened.export(tmp_path / "box.stl")
    (profile,) = measure(scanned_image(image, KNOWN), part).dimensions
    assert profile.value < 1e-3
    assert any("the mesh has holes: where one is, the distance is that to its rim" in note for note in profile.notes)
    box.apply_scale(0.1)
    box.export(tmp_path / "box.stl")
    (profile,) = measure(scanned_image(image, KNOWN), part).dimensions
    assert profile.value is None
    assert "lies" in profile.problem or "mm across" in profile.problem


@pytest.mark.parametrize(
    ("by", "says"),
    [
        (1 / 25.4, 'some would, were it in inch: say so in part.toml by [part] units = "inch"'),
        (25.4, 'some would, were it in mm and not in inch: say so in part.toml by [part] units = "mm"'),
        (1e-3, 'some would, were it in m: say so in part.toml by [part] units = "m"'),
        (100.0, "enlarge the region"),
    ],
)
@pytest.mark.parametrize("kind", ["plane", "surface"])
def test_a_region_in_another_unit_is_said(scene, by, says, kind):
    points = as_image(scene.position, STEPS, RIG)
    region = around(10.0, 0.0, 8.0).scaled(by)
    found = measure(scanned_image(points), replace(PART, features=(Feature("low", kind, region),), dimensions=()))
    assert "no point lies in its region" in found.features[0].problem
    assert says in found.features[0].problem
    box = Region((9.0, -10.0, 200.0), (12.0, 10.0, 600.0)).scaled(by)
    found = measure(scanned_image(points), replace(PART, features=(Feature("low", kind, box),), dimensions=()))
    assert says in found.features[0].problem


@pytest.mark.parametrize(("radius", "refused"), [(1.4, True), (8.0, False)])
def test_a_form_of_few_points_is_refused(near, radius, refused):
    """One patch has no range: the top of a ball was flat within 0.0000 ± 0.0000 mm."""
    face = Feature("face", "plane", around(30.0, 4.0, radius))
    part = replace(PART, features=(face,), dimensions=(Dimension("flatness", "flatness", ("face",)),))
    own = drawn_rig(np.random.default_rng(3), KNOWN)
    (found,) = measure(scanned_image(scan(near, own, np.random.default_rng(4)), own), part).dimensions
    assert (found.value is None) == refused
    assert not refused or "points are too few for a form" in found.problem


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lines", [1, 2, 3])
def test_a_face_of_few_lines_of_light_is_not_taken_for_the_sheet(scene, seed, lines):
    """All points of a line lie in the sheet: of two or three lines a robust fit took this for the face."""
    random = np.random.default_rng([7, seed])
    own = drawn_rig(random, KNOWN)
    image = scan(scene, own, random)
    few = Feature("low", "plane", around(0.0, 0.0, 14.0))
    part = replace(PART, features=(few, PART.features[2]), dimensions=PART.dimensions[1:3])
    low, high = (scanned_image(image, own).within(each.region) for each in part.features)
    of = scanned_image(image, own).place
    frames = np.unique(of[low, 0])
    kept = frames[len(frames) // 2 :][:lines]
    keep = np.zeros(image.valid.shape, bool)
    keep[of[high, 0], of[high, 1]] = True
    # Of three, one has more than half of the points.
    keep[kept], keep[kept[1:], ::3] = True, lines < 3
    found = measure(scanned_image(image.where(keep), own), part)
    step, angle = found.dimensions
    if lines == 1:
        assert "of one line of light" in found.features[0].problem
        assert step.value is None
    else:
        assert abs(step.value - 4.0) < 4 * step.sigma
        # From 0 on angles are positive.
        assert angle.value < 4 * angle.sigma
