"""Which of the camera's parameters are found, and which keep their value."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import scipy.io

from jaxscan import Camera, Rig, calibrate, read_camera, read_rig, refit, write_camera
from jaxscan.calibration import Calibration, Observations
from jaxscan.calibration.diagnostics.halves import halves, solve_apart
from jaxscan.calibration.diagnostics.ladder import climb
from jaxscan.calibration.next_pose import suggest
from jaxscan.cli.estimate_options import Estimate
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.session import CameraSettings
from jaxscan.rig.camera import camera_parameters
from jaxscan.rig.rig import parameter_names
from tests.calibration import synthetic
from tests.other_lenses import Division, registered

K3 = "camera.radial.2"
TERMS = (-0.13396, 0.02, 0.0, 0.001, -0.0005)


@pytest.fixture(scope="module")
def seen() -> Observations:
    """Corners alone, of the lens with one term."""
    seen = synthetic.observations(seed=6, n_views=10, n_stage=0, laser=False)
    return replace(seen, views=tuple(replace(view, stripes=()) for view in seen.views))


@pytest.fixture(scope="module")
def held(seen: Observations) -> Calibration:
    """The toolbox's default: k1 k2 p1 p2, k3 held at 0."""
    return calibrate(seen, lens="brown", hold=[K3])


def test_a_term_is_held_at_zero_without_a_start(held):
    assert float(held.rig.camera.lens.radial[2]) == 0.0
    assert float(held.rig.camera.lens.radial[1]) != 0.0
    assert K3 not in held.covariance.names
    assert set(held.covariance.names) == set(camera_parameters("brown")) - {K3}
    assert held.covariance.of_leaves(held.rig)[6].any() == np.False_


def test_what_is_held_stays_so_in_all_that_is_made_of_it(held, x64):
    # Nothing else compiles again: refit, halves, the ladder and the next poses read what is free as data.
    again = refit(held.adjustment).rig
    np.testing.assert_allclose(jax.tree.leaves(again), jax.tree.leaves(held.rig), rtol=1e-5, atol=1e-8)
    assert float(again.camera.lens.radial[2]) == 0.0
    agreement = solve_apart(held, *(halves(held.observations) or ()))
    assert agreement is not None
    assert K3 not in agreement.names
    wanted = np.eye(len(parameter_names(held.rig)))
    (pose,) = suggest(held, wanted, count=1)
    assert pose.covariance.names == held.covariance.names
    kept = calibrate(held.observations, lens="brown", hold=[K3], keep=held.kept)
    np.testing.assert_allclose(jax.tree.leaves(kept.rig), jax.tree.leaves(held.rig), rtol=1e-4, atol=1e-5)


def test_the_ladder_counts_what_is_sought(held):
    ladder = climb(held)
    # With k3 held radial3 is radial2, which stands for both.
    assert [(r.lens, r.terms) for r in ladder.rungs] == [
        ("none", 0),
        ("radial1", 1),
        ("radial2", 2),
        ("brown", 4),
        ("rational", 7),
    ]
    assert ladder.chosen == "brown"
    assert all(rung.p is None or 0 <= rung.p <= 1 for rung in ladder.rungs)


@pytest.mark.parametrize("name", ["camera.principal.1", "camera.focal.0", "camera.tangential.0"])
def test_any_other_keeps_the_value_of_the_start(seen, name):
    start = Camera.create((640, 480), (698.0, 690.0), (310.0, 228.0), "brown", TERMS[:3], TERMS[3:])
    result = calibrate(seen, start=start, hold=[name])
    at = parameter_names(result.rig).index(name)
    assert float(jax.tree.leaves(result.rig)[at]) == pytest.approx(float(jax.tree.leaves(Rig(start))[at]), rel=1e-7)
    assert set(result.covariance.names) == set(camera_parameters("brown")) - {name}


@pytest.mark.parametrize(
    ("hold", "words"),
    [
        (["lights.0.plane.0"], 'there is no rig whose.*a camera with the lens "radial2" has camera.focal.0'),
        (["camera.radial.2"], 'names camera.radial.2: a camera with the lens "radial2" has .*, camera.radial.1$'),
        (["camera.focal.0"], "there is no start.*--camera FILE"),
        (["camera.principal.1"], 'principal_point = "centre"'),
    ],
)
def test_what_cannot_be_held_is_refused(seen, hold, words):
    with pytest.raises(InputError, match=words):
        calibrate(seen, lens="radial2", hold=hold)


@pytest.fixture
def saved(tmp_path: Path, seen: Observations) -> Path:
    P = seen.board.points()
    variables = {"nx": 640.0, "ny": 480.0}
    for i, view in enumerate(seen.views, start=1):
        variables |= {f"X_{i}": np.stack([P[:, 0], P[:, 1].max() - P[:, 1], 0 * P[:, 2]]), f"x_{i}": view.corners.T}
    scipy.io.savemat(tmp_path / "calib_data.mat", variables)
    return tmp_path / "calib_data.mat"


def test_terms_that_a_file_has_as_zero_stay_zero_and_can_be_freed(saved, tmp_path, capsys):
    """OpenCV with CALIB_FIX_K3 writes k3 = 0."""
    camera, rig = tmp_path / "camera.yml", tmp_path / "rig.json"
    write_camera(
        camera,
        Camera.create((640, 480), (698.0, 690.0), (310.0, 228.0), "brown", TERMS[:3], TERMS[3:]),
        format="opencv",
    )
    argv = ["calibrate", str(saved), "-o", str(rig), "--camera", str(camera)]
    assert main(argv) == 0
    out = capsys.readouterr().out
    assert f"note: {K3} is 0 in {camera} and stayed 0: to estimate one, name it with --free" in out
    content = read_rig(rig)
    assert float(content.rig.camera.lens.radial[2]) == 0.0
    assert content.covariance is not None
    assert set(content.covariance.names) == set(camera_parameters("brown")) - {K3}
    # Kalibr has no k3, and takes a camera without one.
    write_camera(tmp_path / "camera.yaml", content.rig.camera, format="kalibr")
    assert float(read_camera(tmp_path / "camera.yaml").focal[0]) == float(content.rig.camera.focal[0])
    assert main([*argv, "--free", K3]) == 0
    assert "stayed 0" not in capsys.readouterr().out
    assert float(read_rig(rig).rig.camera.lens.radial[2]) != 0.0
    assert main([*argv, "--free", K3, "--hold-camera"]) == 2
    assert f"--free {K3} estimates a part of it" in capsys.readouterr().err
    assert main([*argv, "--free", "camera.radial.0"]) == 2
    assert f"has the terms {K3} as 0" in capsys.readouterr().err


def test_a_camera_that_is_held_is_not_given_a_tilt(saved, tmp_path, capsys):
    """--hold-camera kept all but the tilt, which was found."""
    camera, rig = tmp_path / "camera.yml", tmp_path / "rig.json"
    argv = ["calibrate", str(saved), "-o", str(rig), "--camera", str(camera), "--hold-camera", "--tilt"]
    upright = Camera.create((640, 480), (698.0, 690.0), (310.0, 228.0), "radial1", TERMS[:1])
    write_camera(camera, upright, format="opencv")
    assert main(argv) == 2
    assert f"{camera}: its sensor is not tilted, and --hold-camera keeps it so" in capsys.readouterr().err
    tilted = Camera.create((640, 480), (698.0, 690.0), (310.0, 228.0), "radial1", TERMS[:1], tilt=[1e-3, 0.0])
    write_camera(camera, tilted, format="opencv")
    assert main(argv) == 0
    assert list(read_rig(rig).rig.camera.tilt) == pytest.approx([1e-3, 0.0])


def test_what_is_freed_is_found_though_the_session_holds_it():
    """The command line counts more than the file, as with --lens."""
    session = CameraSettings("brown", hold=(K3, "camera.tangential.0"))
    assert Estimate(free=(K3,)).of(session).hold == ("camera.tangential.0",)


def test_the_toolboxs_default_on_the_command_line(saved, seen, tmp_path, capsys):
    rig = tmp_path / "rig.json"
    report = tmp_path / "report"
    argv = ["calibrate", str(saved), "-o", str(rig), "--lens", "brown", "--plain"]
    assert main([*argv, "--hold", "camera.radial.2,camera.tangential.0", "--report", str(report)]) == 0
    assert "plain least squares" in capsys.readouterr().out
    alone = calibrate(seen, lens="brown", hold=[K3, "camera.tangential.0"], plain=True)
    np.testing.assert_allclose(jax.tree.leaves(read_rig(rig).rig), jax.tree.leaves(alone.rig), rtol=1e-9, atol=1e-12)
    assert (report / "report.html").exists()
    assert main([*argv, "--hold", "camera.radial.5"]) == 2
    assert "names camera.radial.5: a camera with the lens" in capsys.readouterr().err
    assert main([*argv, "--hold", K3, "--free", K3, "--camera", str(rig)]) == 2
    assert f"--hold and --free both name {K3}" in capsys.readouterr().err
    assert main([*argv, "--camera", str(rig)]) == 2
    assert "brings its own lens" in capsys.readouterr().err


def test_the_tilt_on_the_command_line(saved, tmp_path, capsys):
    rig = tmp_path / "rig.json"
    argv = ["calibrate", str(saved), "-o", str(rig), "--lens", "radial3", "--tilt"]
    assert main(argv) == 0
    content = read_rig(rig)
    assert len(content.rig.camera.tilt) == 2
    assert {"camera.tilt.0", "camera.tilt.1"} < set(content.covariance.names)
    capsys.readouterr()
    assert main(["inspect", str(rig)]) == 0
    out = capsys.readouterr().out
    assert "tilt of the sensor" in out
    assert "±" in next(line for line in out.splitlines() if "tilt of the sensor" in line)
    assert main([*argv, "--hold", "camera.tilt.0,camera.tilt.1"]) == 0
    assert read_rig(rig).rig.camera.tilt == ()
    assert main([*argv[:-1], "--hold", "camera.tilt.0"]) == 2
    assert "hold names camera.tilt.0" in capsys.readouterr().err


def test_a_lens_of_another_kind_on_the_command_line(saved, tmp_path, capsys):
    rig = tmp_path / "rig.json"
    argv = ["calibrate", str(saved), "-o", str(rig), "--lens", "division"]
    with registered(Division):
        assert main([*argv, "--hold", "camera.division.0"]) == 0
        out = capsys.readouterr().out
        assert "The lens model does not fit with camera.division.0 held" in out
        assert "Free camera.division.0, held here, or try another lens" in out
        assert main(argv) == 0
        assert read_rig(rig).rig.camera.lens.kind == "division"
        assert main(["inspect", str(rig)]) == 0
        assert "division terms" in capsys.readouterr().out
        assert main([*argv, "--hold", "camera.radial.0"]) == 2
        assert 'with the lens "division" has camera.focal.0' in capsys.readouterr().err
    assert main(argv) == 2
    assert 'there is no lens "division": use one of none, radial1' in capsys.readouterr().err
