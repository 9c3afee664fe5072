"""Parameters of lights and motion that keep the value of a rig, beside those of the camera."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from benchmarks.drawn import Noise, exact_session, redrawn
from jaxscan import calibrate
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003

STAGE = tuple(f"motion.stage.per_step.{i}" for i in range(3))


def values(rig):
    return dict(zip(parameter_names(rig), map(float, jax.tree.leaves(rig)), strict=True))


@pytest.fixture(scope="module")
def drawn():
    true, exact = exact_session(0)
    return true, redrawn(exact, Noise(0.05, 0.1), np.random.default_rng(3))


@pytest.fixture(scope="module")
def whole(drawn):
    return calibrate(drawn[1])


def plane_names(rig):
    return tuple(name for name in parameter_names(rig) if name.startswith("lights.0."))


@pytest.mark.parametrize("which", ["stage", "one of the stage", "light", "all"])
def test_what_is_held_keeps_its_value_and_has_no_sigma(drawn, whole, which):
    true, observations = drawn
    hold = {"stage": STAGE, "one of the stage": STAGE[2:], "light": plane_names(true)}.get(
        which, tuple(name for name in parameter_names(true) if not name.startswith("camera."))
    )
    found = calibrate(observations, start=true, hold=hold)
    known, own, free = values(true), values(found.rig), values(whole.rig)
    for name in hold:
        assert own[name] == known[name] != free[name]
        assert name not in found.covariance.names
    rest = [name for name in parameter_names(true) if name not in hold]
    assert set(found.covariance.names) >= set(rest)
    # What is known makes the rest no less certain, and moves it by no more than that says.
    for name in rest:
        assert found.covariance.sigma(name) <= 1.02 * whole.covariance.sigma(name)
        assert abs(own[name] - free[name]) < 4 * whole.covariance.sigma(name)


def test_a_rig_to_start_from_holds_nothing_by_itself(drawn, whole):
    true, observations = drawn
    found, expected = values(calibrate(observations, start=true).rig), values(whole.rig)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-3 * whole.covariance.sigma(name))


def test_what_cannot_be_held(drawn):
    true, observations = drawn
    with pytest.raises(InputError, match=r"hold names motion\.stage\.per_step\.0.*there is no rig.*start= a Rig"):
        calibrate(observations, hold=STAGE)
    with pytest.raises(InputError, match="there is no rig whose value it could keep"):
        calibrate(observations, start=true.camera, hold=STAGE)
    with pytest.raises(InputError, match=r"hold names motion\.stage\.speed: the rig to start from has .*per_step"):
        calibrate(observations, start=true, hold=("motion.stage.speed",))


def test_a_number_that_only_the_other_kind_has_cannot_be_held(drawn):
    true, observations = drawn
    bowed = rig_2003.simulated_rig(0, 1, 0.3)
    (name, *_) = [name for name in plane_names(bowed) if name not in plane_names(true)]
    with pytest.raises(InputError, match=f"hold names {name}, which the rig that is sought does not have"):
        calibrate(observations, start=bowed, hold=(name,))


def test_on_the_command_line(world, tmp_path, monkeypatch, drawn, capsys):
    true, observations = drawn
    monkeypatch.setattr("jaxscan.calibration.observe.observe", lambda content, *_: observations)
    write_rig(tmp_path / "known.json", replace(calibrate(observations).rig_file(), rig=true))
    out, known = tmp_path / "rig.json", str(tmp_path / "known.json")
    words = ["calibrate", str(world / "session"), "-o", str(out), "--hold", ",".join(STAGE)]
    assert main([*words, "--camera", known]) == 0
    found = values(read_rig(out).rig)
    assert [found[name] for name in STAGE] == [values(true)[name] for name in STAGE]
    capsys.readouterr()
    assert main(words) == 2
    assert "--camera rig.json on the command line" in capsys.readouterr().err
