"""A sheet that was taken as flat and is not is named, a bent board is not called one."""

import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.view.model_findings import model_findings
from tests.calibration import sheets, synthetic


@pytest.mark.parametrize("sag", [0.05, pytest.param(0.3, marks=pytest.mark.long), -2.0])
def test_a_curved_sheet_is_named_with_its_millimetres(sag, tmp_path):
    result = calibrate(sheets.session(0, sheets.cone(sag)))
    (curve,) = result.sheet_curves
    assert curve.width_mm == 200
    # At the stripes' own depth, where a given width is a little narrower or wider in the fan.
    assert abs(curve.curve_mm - sag * sheets.DEPTH / curve.depth_mm) < 3 * curve.sigma_mm
    # Two millimetres are a doubt of the whole plane besides.
    warning, *doubts = result.warnings
    assert all("does not fit the stripes" in doubt for doubt in doubts)
    assert not doubts or abs(sag) > 1
    assert warning.startswith(f"The sheet of light is curved by {abs(curve.curve_mm):.2g} ± ")
    assert "mm over 200 mm" in warning
    assert "--sheet bowed fixes it" in warning
    write_rig(tmp_path / "rig.json", result.rig_file())
    assert read_rig(tmp_path / "rig.json").warnings == result.warnings
    boxes = model_findings(result, diagnose(result, thorough=False))
    assert [box.level for box in boxes if "is curved by" in box.statement] == ["care"]
    assert not [box for box in boxes if "the plates are bent" in box.statement]


def test_what_was_named_is_mended():
    result = calibrate(sheets.session(0, sheets.cone(0.3)), light="bowed")
    assert (result.sheet_curves, result.warnings) == ((), ())


@pytest.mark.parametrize("bend", [(0.0, 0.0), (0.3, 0.0), (0.1, -0.2)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_a_flat_sheet_on_a_flat_or_a_bent_board_is_not_called_curved(bend, seed):
    assert calibrate(sheets.session(seed, sheets.cone(0.0), board_mm=bend)).sheet_curves == ()


def test_stripes_on_boards_that_move_count():
    assert calibrate(synthetic.observations(0, n_stage=8, stripes_on_stage=True)).sheet_curves == ()


TAKEN = ({}, {"light": "bowed"}, {"board_shape": "bend"})
# Of a sheet's curve, a board's bulge (mm) and how both are taken a quick run tries these.
QUICK = [(0.05, 0.0, 0), *((0.3, 0.2, i) for i in range(3))]


@pytest.mark.parametrize(
    ("sag", "bulge", "taken"),
    [
        pytest.param(sag, bulge, TAKEN[i], marks=[] if (sag, bulge, i) in QUICK else [pytest.mark.long])
        for sag in (0.05, 0.3)
        for bulge in (0.0, 0.2)
        for i in range(3)
    ],
)
def test_a_curved_sheet_and_a_bent_board_are_told_apart(sag, bulge, taken):
    result = calibrate(sheets.session(1, sheets.cone(sag), board_mm=(bulge, 0.0)), **taken)
    assert result.flatness is not None
    assert result.flatness.bent == (bulge > 0 and "board_shape" not in taken)
    if result.flatness.bent:
        assert abs(result.flatness.bent_mm - bulge) < 0.1 * bulge + 3 * result.flatness.bent_sigma_mm
    # Beside a board bent by more than the sheet is curved, what is left of the board in the residuals hides the sheet.
    if bulge <= sag or "board_shape" in taken:
        assert len(result.sheet_curves) == ("light" not in taken)


def test_a_bowed_sheet_on_boards_that_bend_is_found_with_both():
    result = calibrate(sheets.session(2, sheets.cone(0.3), board_mm=(0.3, -0.2)), light="bowed", board_shape="bend")
    assert result.warnings == ()
    assert result.flatness is not None
    assert abs(result.flatness.bent_mm - 0.5) < 0.03
