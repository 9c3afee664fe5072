"""Regions that a coloured reference mesh marks: the same dimensions as by balls, wherever the part lies."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from benchmarks.measured_parts import at, drawn_rig, scan
from jaxscan.errors import InputError
from jaxscan.files.part_file import read_part
from jaxscan.files.part_write import part_text
from jaxscan.files.region import Region
from jaxscan.geometry import Pose
from jaxscan.measurement.measure import measure
from jaxscan.measurement.scanned import scanned_image, scanned_points
from tests.measurement.test_measure import KNOWN, PART, STEPS, TRUTH, Scene, Y, implicit, level

RED, GREEN, BLUE, GREY = (200, 30, 30), (30, 160, 40), (40, 60, 220), (120, 120, 120)
FEATURES = {"ball": ("ball", GREEN), "low": ("plane", RED), "high": ("plane", BLUE)}


def reference(path, motion=None):
    """The part of `level` as a mesh, in the object frame, or moved from there."""

    def square(x, y, z, colour):
        corners = [(a, b, c) for a in x for b in y for c in z]
        return np.array([corners[:3], corners[1:][::-1]]), [colour] * 2

    dome = trimesh.creation.icosphere(3, 9.0)
    dome.apply_translation([-30.0, Y, 3.0])
    y = (Y - 60, Y + 60)
    pieces = [
        (dome.triangles, [GREEN] * len(dome.faces)),
        square((-80.0, 20.0), y, (0.0,), RED),
        square((20.0, 80.0), y, (4.0,), BLUE),
        square((20.0,), y, (0.0, 4.0), GREY),
    ]
    corners = np.concatenate([each for each, _ in pieces]).reshape(-1, 3)
    origin = np.array(at(0, 0, 0))
    axes = [np.array(at(*axis)) - origin for axis in np.eye(3)]
    corners = origin + corners @ np.array(axes)
    if motion is not None:
        corners = motion.apply(corners)
    faces = np.arange(len(corners)).reshape(-1, 3)
    colours = np.concatenate([each for _, each in pieces]).astype(np.uint8)
    mesh = trimesh.Trimesh(corners, faces, face_colors=colours, process=False)
    mesh.export(path)


def part_of(folder, about=""):
    text = f'[part]\nreference = "block.ply"\n{about}\n'
    for name, (kind, colour) in FEATURES.items():
        text += f'[[feature]]\nname = "{name}"\nkind = "{kind}"\ncolour = "#{bytes(colour).hex()}"\n'
    text += '[[dimension]]\nname = "radius"\nkind = "radius"\nof = "ball"\n'
    text += '[[dimension]]\nname = "step"\nkind = "step"\nof = ["low", "high"]\n'
    (folder / "part.toml").write_text(text)
    return read_part(folder)


@pytest.fixture(scope="module")
def scanned():
    random = np.random.default_rng([7, 0])
    own = drawn_rig(random, KNOWN)
    return scanned_image(scan(Scene(implicit(level, STEPS), STEPS, PART, TRUTH), own, random), own)


def check(found):
    for each in found.dimensions:
        assert not each.problem
        low, high = each.interval
        assert low <= TRUTH[each.dimension.name] <= high
        assert high - low < 0.3
    return {each.dimension.name: each for each in found.dimensions}


def test_dimensions_are_those_of_balls(tmp_path, scanned):
    reference(tmp_path / "block.ply")
    by_colour, by_ball = check(measure(scanned, part_of(tmp_path))), measure(scanned, PART)
    for each in by_ball.dimensions:
        if each.dimension.name in by_colour:
            other = by_colour[each.dimension.name]
            # Within 3 σ of what fewer points give.
            assert other.value == pytest.approx(each.value, abs=1.5 * each.uncertainty)
            assert other.uncertainty < each.uncertainty
    # A face's points are all of it: more than a ball of 8 mm holds.
    found = measure(scanned, part_of(tmp_path))
    points = {each.feature.name: each.points for each in (*by_ball.features, *found.features)}
    assert points["low"] > 2 * next(each.points for each in by_ball.features if each.feature.name == "low")


@pytest.mark.parametrize(("turn", "shift"), [pytest.param(0.05, 3.0, marks=pytest.mark.long), (0.4, 20.0)])
def test_a_reference_that_lies_elsewhere_is_moved_onto_the_surface(tmp_path, scanned, turn, shift):
    reference(tmp_path / "block.ply", Pose(np.array([0.2, 1.0, -0.4]) * turn, np.array([1.0, -0.6, 0.4]) * shift))
    # Where it is, it marks what is elsewhere.
    apart = measure(scanned, part_of(tmp_path))
    assert any(each.problem for each in apart.dimensions) or apart.dimensions[0].value != pytest.approx(9.0, abs=0.01)
    found = measure(scanned, part_of(tmp_path, "fit = true"))
    check(found)
    assert any("the reference mesh was moved by" in note for note in found.notes)


def test_a_reference_of_another_thing_is_refused(tmp_path, scanned):
    reference(tmp_path / "block.ply")
    away = np.random.default_rng(0).uniform(-60, 60, (800, 3))
    with pytest.raises(InputError, match=r"block\.ply: .*say where the part lies by box = or ball ="):
        measure(scanned_points(away), part_of(tmp_path, "fit = true"))


def test_points_without_a_rig_have_regions_too(tmp_path, scanned):
    reference(tmp_path / "block.ply")
    found = measure(scanned_points(scanned.points), part_of(tmp_path))
    assert found.dimensions[1].value == pytest.approx(4.0, abs=0.1)


def test_only_the_points_near_regions_are_kept(tmp_path, scanned):
    reference(tmp_path / "block.ply")
    part = replace(part_of(tmp_path), features=part_of(tmp_path).features[:1])
    assert scanned.image is not None
    near = scanned_image(scanned.image, KNOWN, part)
    assert len(near.points) < 0.5 * len(scanned.points)


def test_it_is_written_as_it_was_read(tmp_path):
    reference(tmp_path / "block.ply")
    part = part_of(tmp_path, "fit = true\nwithin = 0.8\nball = [1, 2, 3, 40]")
    (tmp_path / "part.toml").write_text(part_text(part))
    again = read_part(tmp_path)
    assert (again.fit, again.where) == (True, part.where)
    for a, b in zip(part.features, again.features, strict=True):
        assert (a.name, a.kind, a.region.colour, a.region.within) == (b.name, b.kind, b.region.colour, b.region.within)


def test_a_table_is_left_out_of_the_fit_by_a_box(tmp_path, scanned):
    """Twice as many points of a table 60 mm below the part; an eighth of the points, for there are 100 rounds."""
    own = scanned.points[::8]
    reference(tmp_path / "block.ply", Pose(np.array([0.05, 0.1, -0.03]), np.array([3.0, -6.0, 4.0])))
    table = np.random.default_rng(0).uniform(-300, 300, (2 * len(own), 2))
    table = (
        np.array([at(0, 0, -60)]) + table @ np.array([at(1, 0, 0), at(0, 1, 0)]) - table @ np.array([at(0, 0, 0)] * 2)
    )
    both = scanned_points(np.concatenate([own, table]))
    with pytest.raises(InputError, match="say where the part lies"):
        measure(scanned_points(both.points[::3]), part_of(tmp_path, "fit = true"))
    low, high = own.min(axis=0) - 1, own.max(axis=0) + 1
    inside = Region(tuple(low.tolist()), tuple(high.tolist()))
    assert inside.holds(table).mean() < 0.3
    found = measure(both, part_of(tmp_path, f"fit = true\nbox = {[low.tolist(), high.tolist()]}"))
    assert found.dimensions[0].value == pytest.approx(9.0, abs=0.1)
    assert found.dimensions[1].value == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('reference = "block.ply"', "", r"\[\[feature\]\] 'ball' colour = .*there is no mesh .*add reference ="),
        ('"block.ply"', '"none.ply"', r"\[part\] reference = \"none\.ply\": .*no such file"),
        ('"block.ply"', '"block.ply"\nwithin = 0', r"within = 0: must be more than 0"),
        ('"block.ply"', '"block.ply"\nball = [0, 0, 0, 9]', r"\[part\] ball = .*with it fit = true"),
        ('reference = "block.ply"', "fit = true", r"fit = true: is about a reference mesh"),
        ("#c81e1e", "red", r"colour = \"red\": is no colour: write"),
        ("#c81e1e", "#00ffff", r"no face of .*block\.ply has this colour: its faces have #"),
        ('colour = "#c81e1e"', 'colour = "red"\nball = [0, 0, 0, 1]', r"give one of box = .*and colour ="),
        ('"#c81e1e"', "[200, 30, 30]", r"colour = .*must be a text"),
    ],
)
def test_what_is_refused(tmp_path, old, new, words):
    reference(tmp_path / "block.ply")
    part_of(tmp_path)
    text = (tmp_path / "part.toml").read_text()
    assert old in text
    (tmp_path / "part.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_part(tmp_path)
