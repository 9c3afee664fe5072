"""Acceptance tests of a drawn plate with two balls: by its own rig, by one that was spoiled, and their history."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import numpy as np
import pytest

from benchmarks.measured_parts import Scene, as_image, drawn_rig, implicit, scan
from jaxscan.errors import InputError
from jaxscan.files.acceptance_history import add_to_history, read_history
from jaxscan.files.artefact_file import CertifiedBall, CertifiedDistance, CertifiedPlane, read_artefact
from jaxscan.measurement.accept import accept, band
from jaxscan.measurement.drift import as_test, changes
from jaxscan.measurement.known_balls import _told_apart, known_balls
from jaxscan.measurement.scanned import scanned_image
from jaxscan.measurement.shapes import Ball
from tests.measurement.test_measure import KNOWN, PART, RIG, STEPS, Y
from tests.test_docs import ROOT, blocks

RADIUS, APART = 7.0, 50.0


def level(x):
    """Two balls of 7 mm, half of each in a plate."""
    balls = [np.linalg.norm(x - np.array([x0, Y, 0.5]), axis=1) - RADIUS for x0 in (-APART / 2, APART / 2)]
    return np.minimum(np.minimum(*balls), x[:, 2])


@cache
def scene():
    return Scene(implicit(level, STEPS), STEPS, PART, {})


def scans(count, share=0.5, rig=None):
    """So many scans, each with noise of its own, by one rig."""
    own = drawn_rig(np.random.default_rng(7), KNOWN) if rig is None else rig
    return own, [(f"{k}.npz", scan(scene(), own, np.random.default_rng([9, k]), share)) for k in range(count)]


def spoiled():
    """The light was knocked after the calibration: the rig's file has it where it was, 3 % nearer."""
    plane = lambda rig: rig.lights[0].plane[2]  # noqa: E731
    return replace(KNOWN, rig=eqx.tree_at(plane, RIG, np.asarray(1.03 * plane(RIG))))


@pytest.fixture
def artefact(tmp_path):
    (text,) = blocks(ROOT / "docs" / "accept.md", "toml")
    (tmp_path / "artefact.toml").write_text(text)
    return read_artefact(tmp_path)


def test_balls_are_found_by_their_diameter(artefact):
    rig, ((_, image),) = scans(1)
    regions = known_balls(scanned_image(image, rig), artefact)
    left, right = (np.asarray(regions[name].low) for name in ("left", "right"))
    assert left[0] < right[0]
    assert np.linalg.norm(left - right) == pytest.approx(APART, abs=0.2)
    other = replace(artefact, balls=tuple(replace(ball, diameter=20.0) for ball in artefact.balls))
    with pytest.raises(InputError, match="0 of 2 balls of 20 mm were found: see that the scan"):
        known_balls(scanned_image(image, rig), other)


def test_distances_tell_balls_of_one_size_apart(artefact):
    """A third ball, between the two and nearer to the left one, is named by its distance."""
    names = ("a", "b", "c")
    balls = tuple(CertifiedBall(name, 14.0, 0.01) for name in names)
    at = {name: Ball(np.array([x, 0.0, 0.0]), np.eye(3)[2], 7.0, 7.0) for name, x in (("a", 0), ("b", 20), ("c", 50))}
    distances = tuple(CertifiedDistance(of, d, 0.1) for of, d in ((("a", "b"), 30.0), (("b", "c"), 50.0)))
    regions = _told_apart(at, replace(artefact, balls=balls, distances=distances))
    assert regions["a"].low[0] == 20
    assert regions["b"].low[0] == 50
    assert regions["c"].low[0] == 0


def test_diameters_tell_balls_of_nearly_one_size_apart(artefact):
    """A bar of 20.0 and 20.9 mm that lies the other way round."""
    balls = (CertifiedBall("a", 20.0, 0.01), CertifiedBall("b", 20.9, 0.01))
    at = {name: Ball(np.array([x, 0.0, 0.0]), np.eye(3)[2], r, r) for name, x, r in (("a", 0, 10.47), ("b", 50, 9.98))}
    distances = (CertifiedDistance(("a", "b"), 50.0, 0.1),)
    regions = _told_apart(at, replace(artefact, balls=balls, distances=distances))
    assert regions["b"].low[0] == 0
    assert regions["a"].low[0] == 50


def test_a_sound_scanner_conforms(artefact):
    rig, several = scans(3)
    found = accept(several, rig, artefact)
    assert not found.problems
    assert found.verdict == "conforming"
    assert len(found.figures) == 3 * 6
    for each in (*found.of("distance"), *found.of("probing_size")):
        assert abs(each.error) < 3.5 * np.hypot(each.sigma, each.sigma_rig)
        assert not each.unexplained
    # A band that holds 95 % of normal errors is 3.92 σ wide: here σ is that of half the drawn noise, about 0.045 mm.
    for each in found.of("flatness"):
        assert 0.1 < each.error < 0.3
    assert any("3 of the 7 places that VDI/VDE 2634 part 2 asks for" in note for note in found.notes)


def test_a_scanner_whose_light_was_knocked_fails_and_that_is_not_predicted(artefact):
    rig = spoiled()
    found = accept([("a.npz", as_image(scene().position, STEPS, rig.rig))], rig, artefact)
    assert found.verdict == "not conforming"
    (distance,) = found.of("distance")
    assert distance.verdict == "not conforming"
    assert distance.unexplained
    assert any("larger than the calibration and the certificate explain: distance of" in note for note in found.notes)


def test_a_certificate_that_is_too_coarse_decides_nothing(artefact):
    rig, several = scans(1)
    coarse = replace(artefact, distances=(replace(artefact.distances[0], uncertainty=0.5),))
    found = accept(several, rig, coarse)
    assert found.of("distance")[0].verdict == "not decided"
    assert found.verdict == "not decided"


def test_what_cannot_be_found_is_told_and_nothing_is_passed(artefact):
    rig, ((_, image),) = scans(1)
    covered = replace(image, valid=image.valid & (image.points[..., 0] < 0))
    found = accept([("half.npz", covered)], rig, artefact)
    assert found.verdict == "not decided"
    assert found.problems[0].startswith("half.npz: 1 of 2 balls of 14 mm were found")
    with pytest.raises(InputError, match="there are no scans"):
        accept([], rig, artefact)
    with pytest.raises(InputError, match="one scan is named twice"):
        accept([("a", image), ("a", image)], rig, artefact)
    with pytest.raises(InputError, match="b: holds the same points as a: leave it out"):
        accept([("a", image), ("b", image)], rig, artefact)


def test_a_band_is_the_narrowest_that_holds_its_share():
    assert band(np.r_[np.linspace(0, 1, 95), np.full(5, 9.0)]) == pytest.approx(1.0)
    assert band(np.random.default_rng(0).normal(size=200_000)) == pytest.approx(2 * 1.96, rel=0.01)


def test_drift_is_named_only_where_it_is_more_than_its_uncertainty(artefact):
    rig, several = scans(6, share=0.3)
    first, second = accept(several[:3], rig, artefact), accept(several[3:], rig, artefact)
    knocked = spoiled()
    again = [(f"{k}.npz", scan(scene(), knocked, np.random.default_rng(k), 0.3)) for k in range(3)]
    third = accept(again, knocked, artefact)
    tests = [as_test(f, f"2026-0{k}-01T00:00:00+00:00", "c", "r") for k, f in enumerate((first, second), 1)]
    assert [each.figure for each in changes(tests) if each.real] == []
    tests.append(as_test(third, "2026-03-01T00:00:00+00:00", "c", "r"))
    named = {each.figure: each for each in changes(tests) if each.real}
    assert "distance" in named
    assert named["distance"].tests == 3
    assert changes(tests[:1]) == []


def history(*tests: tuple[float, str]) -> list[dict]:
    """Tests of one figure: its mean error, mm, and the rig, day by day."""
    row = {"figure": "distance", "of": "l-r", "uncertainty": 0.01, "limit": 0.1}
    row |= {"sigma": 0.003, "sigma_rig": 0.01, "scans": 3}
    common = {"artefact": "plate", "certificate": "c"}
    return [
        {**common, "date": f"2026-01-{day:02}", "rig": rig, "figures": [{**row, "mean": mean, "worst": mean}]}
        for day, (mean, rig) in enumerate(tests, 1)
    ]


def test_a_change_counts_from_the_last_calibration():
    """A scanner that was calibrated anew was told to calibrate again for ever."""
    (found,) = changes(history((0.3, "a"), *[(0.0, "b")] * 5))
    assert (found.real, found.change, found.tests, found.first) == (False, 0.0, 5, "2026-01-02")
    (found,) = changes(history((0.0, "a"), (0.0, "a"), (0.3, "b")))
    assert (found.real, found.recalibrated, found.tests) == (False, True, 2)
    (found,) = changes(history((0.3, "a"), (0.0, "b"), (0.1, "b")))
    assert (found.real, found.recalibrated) == (True, False)


def test_what_was_off_in_between_is_said():
    (found,) = changes(history((0.0, "a"), (0.1, "a"), (0.2, "a"), (0.001, "a")))
    assert not found.real
    assert found.between == ("2026-01-03", 0.2)
    for still in (history((0.0, "a"), (0.2, "a"), (0.2, "a")), history((0.0, "a"), (0.002, "a"), (0.0, "a"))):
        assert changes(still)[0].between is None
    # Of many tests one is far off by chance.
    random = np.random.default_rng(0)
    alarms = [changes(history(*((random.normal(0, 0.003), "a") for _ in range(30))))[0].between for _ in range(200)]
    assert sum(alarm is not None for alarm in alarms) <= 10


@pytest.mark.parametrize(("share", "verdict"), [(0.03, "conforming"), (0.2, "not conforming")])
def test_points_in_the_air_are_of_the_form(artefact, share, verdict):
    """A fifth of the points is up to 3 mm off: the fit leaves them out, and the form must not."""
    rig, ((name, image),) = scans(1)
    random = np.random.default_rng(1)
    off = np.where(random.random(image.valid.shape) < share, random.uniform(-3, 3, image.valid.shape), 0.0)
    away = image.points / np.linalg.norm(image.points, axis=-1, keepdims=True)
    flying = replace(image, points=(image.points + off[..., None] * away).astype(np.float32))
    figures = ("probing_form", "flatness")
    found = accept([(name, flying)], rig, replace(artefact, limits=dict.fromkeys(figures, 0.8)))
    assert not found.problems
    for each in (row for figure in figures for row in found.of(figure)):
        assert each.verdict == verdict
        assert each.left_out / each.points == pytest.approx(share * 0.85, rel=0.35)
    assert any("of its points are outliers" in note for note in found.notes)


def test_a_limit_that_was_not_tested_is_not_met(artefact):
    rig, several = scans(1)
    plane = replace(artefact, balls=(), distances=(), plane=CertifiedPlane("plane", 0.01))
    found = accept(several, rig, plane)
    assert found.of("flatness")[0].verdict == "conforming"
    assert found.verdict == "not decided"
    assert any(
        "distance: not tested, though it has a limit: artefact.toml describes no" in each for each in found.notes
    )
    only = accept(several, rig, replace(plane, limits={"flatness": 0.8}))
    assert only.verdict == "conforming"
    assert only.places == "(1 of the 6 recommended places)"


def test_what_is_not_the_artefact_is_refused(artefact):
    """Two balls that are elsewhere: nothing of it may get into the history."""
    rig, each = scans(1)
    other = replace(artefact, distances=tuple(replace(one, length=62.0) for one in artefact.distances))
    found = accept(each, rig, other)
    assert "62 mm are certified, and no scanner errs so much" in found.problems[0]
    assert not found.figures


def test_the_history_is_only_added_to(artefact, tmp_path):
    path = tmp_path / "history.jsonl"
    test = {"date": "2026-01-01", "artefact": "a", "certificate": "c", "rig": None, "verdict": None, "figures": []}
    add_to_history(path, test)
    before = path.read_bytes()
    add_to_history(path, test)
    assert path.read_bytes().startswith(before)
    assert len(read_history(path)) == 2
    assert [each.name for each in tmp_path.iterdir()] in (["artefact.toml", path.name], [path.name, "artefact.toml"])
    for text, words in (("{", "line 3: is no JSON"), ('{"format": "other"}', "line 3: is no jaxscan-acceptance/1")):
        path.write_bytes(before * 2 + text.encode())
        with pytest.raises(InputError, match=words):
            add_to_history(path, test)
        assert path.read_bytes() == before * 2 + text.encode()
    with pytest.raises(InputError, match="there is no such history"):
        read_history(tmp_path / "none.jsonl")
