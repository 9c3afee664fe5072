"""The sections of a calibration's report about what moves: stage, turntable, and a robot's given poses."""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics
from jaxscan.calibration.hand import Hand
from jaxscan.rig.summary import axis_summary, format_path
from jaxscan.view import calibration_plots as plots
from jaxscan.view.report import Section, Table, draw


def stage(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """Which way it goes, step error and straightness."""
    rows = []
    words = tuple(
        f"With rising step counts what stands on the {summary['axis']} moves {summary['way']}, as the camera sees it, "
        f"by {summary['mm_per_1000_steps']:.5g} mm in 1000 steps. If it really moves the other way, the steps in "
        "session.toml run backwards: nothing else shows that."
        + "".join(f" It is {line}." for line in format_path(summary))
        for summary in axis_summary(calibration.rig, calibration.covariance)
        if "mm_per_1000_steps" in summary
    )
    for s in diagnostics.stages:
        along = 1000 * _rms(s.error_mm[:, 0])
        across = 1000 * np.sqrt((s.error_mm[:, 1:] ** 2).mean(axis=0))
        turned = np.abs(s.rotation_mrad).max()
        rows.append(
            (
                f"{s.names[0]} … {s.names[-1]}",
                f"{np.ptp(s.travel_mm):.2f}",
                f"{along:.1f}",
                f"{np.sqrt(s.chi2_along):.2f}",
                f"{across[0]:.1f}, {across[1]:.1f}",
                f"{np.sqrt(s.chi2_across):.2f}",
                f"{turned:.2f} ± {s.rotation_sigma_mrad.flat[np.abs(s.rotation_mrad).argmax()]:.2f}",
            )
        )
    columns = (
        "photographs",
        "travel / mm",
        "step error / µm RMS",
        "in σ",
        "off the line / µm RMS",
        "in σ",
        "largest turn / mrad",
    )
    return Section(
        "The stage",
        paragraphs=words,
        tables=(Table("The real places of the board, compared with one line", columns, tuple(rows)),),
        figures=(
            draw(
                "stage",
                "Step error along the travel and distance from the straight line, with the σ that the corners leave. "
                "A period is the lead screw's, a jump a missed step, a bow the guide's.",
                plots.stage(diagnostics.stages),
            ),
        ),
    )


def turntable(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """Axis and angle with their σ, errors of the angle and wobble."""
    rows = []
    for t in diagnostics.turntables:
        turn, wobble = t.turn_error_deg[:, 0], t.turn_error_deg[:, 1:]
        rows.append(
            (
                f"{t.names[0]} … {t.names[-1]}",
                f"{np.ptp(t.turn_deg):.2f}",
                f"{_rms(turn):.4f}",
                f"{np.sqrt(t.chi2_turn):.2f}",
                f"{_rms(wobble):.4f}",
                f"{1000 * _rms(t.error_mm[:, 0]):.1f}, {1000 * _rms(t.error_mm[:, 1:]):.1f}",
                f"{np.sqrt(t.chi2_wobble):.2f}",
            )
        )
    columns = (
        "photographs",
        "turn / °",
        "angle / ° RMS",
        "in σ",
        "tilt of the axis / ° RMS",
        "along the axis, across it / µm RMS",
        "in σ",
    )
    words = tuple(
        f"With rising step counts the {summary['axis']} turns {summary['way']} as the camera sees it, by "
        f"{summary['degrees_per_step']:.7g} ± {summary['degrees_per_step_sigma']:.2g}° a step, about the axis "
        f"({_triple(summary['axis_direction'], 5)}) ± {summary['axis_sigma_deg']:.2g}° through "
        f"({_triple(summary['through_mm'], 3)}) ± {summary['through_sigma_mm']:.2g} mm. "
        "If it really turns the other way, the steps in session.toml run backwards: nothing else shows that."
        for summary in axis_summary(calibration.rig, calibration.covariance)
        if "degrees_per_step" in summary
    )
    return Section(
        "The turntable",
        paragraphs=words,
        tables=(Table("The real places of the board, compared with one turn about one axis", columns, tuple(rows)),),
        figures=(
            draw(
                "turntable",
                "Errors of the angle, and tilt of the axis, against the turn, with the σ that the corners leave. One "
                "period in a turn is an eccentric or tilted table, many are the gear's, a jump is a missed step.",
                plots.turntable(diagnostics.turntables),
            ),
        ),
    )


def hand(hand: Hand) -> Section:
    """Each given pose, and how far it is from where the photograph shows the hand."""
    mm, degrees = hand.how_far_off
    rows = [
        (name, f"{mm[i]:.3f}", f"{degrees[i]:.3f}", "yes" if hand.kept[i] else "no")
        for i, name in enumerate(hand.names)
    ]
    order = np.argsort(-mm)
    columns = ("photograph", "position off / mm", "turn off / °", "used")
    return Section(
        "Given poses",
        paragraphs=(
            f"{hand.note()[0].upper()}{hand.note()[1:]}. Taken as σ: {hand.sigma_mm:.2g} mm and {hand.sigma_deg:.2g}°. "
            "The errors are the robot's, of the hand in the base's frame; those of the photographs are smaller. A pose "
            "that stands out was read at another moment, or belongs to another photograph.",
        ),
        tables=(Table("Given less found, the farthest first", columns, tuple(rows[i] for i in order)),),
    )


def _triple(values: tuple[float, ...], digits: int) -> str:
    return ", ".join(f"{x:.{digits}f}" for x in values)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))
