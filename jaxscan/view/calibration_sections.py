"""The sections of a calibration's report that show its numbers: a table and its figures each, with how to read them."""

import jax
import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics, Ladder
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.files.rig_checks import image_rays
from jaxscan.images.light import Light
from jaxscan.phrases import laser_called, of_laser
from jaxscan.reconstruction.working_volume import WorkingVolume, volume_rays
from jaxscan.rig import BowedSheet
from jaxscan.rig.board_shape import shape_in_words
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.speckle_limit import Optics, limit_of
from jaxscan.rig.summary import HALF_WIDTH_MM, light_summary
from jaxscan.view import calibration_plots as plots
from jaxscan.view.report import Section, Table, draw


def rig(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """The parameters with their σ, and how the two halves differ."""
    values = dict(zip(parameter_names(calibration.rig), map(float, jax.tree.leaves(calibration.rig)), strict=True))
    halves = diagnostics.halves
    apart = dict(zip(halves.names, halves.differences_in_sigma, strict=True)) if halves else {}
    wider, rows = calibration.widened_by(), []
    for name, value in values.items():
        sigma = calibration.covariance.sigma(name)
        difference = f"{apart[name]:+z.1f} σ" if name in apart else "–"
        alone = f"{sigma / wider[name]:.2g}" if sigma is not None else "–"
        rows.append((name, f"{value:.7g}", f"{sigma:.2g}" if sigma is not None else "held", alone, difference))
    columns = ("parameter", "value", "σ", "σ of noise alone", "two halves differ by")
    paragraph = (
        f"Corners have σ = {calibration.corner_sigma_px:.3f} px along each axis"
        + (f", stripe points {calibration.stripe_sigma_px:.3f} px" if calibration.stripe_sigma_px is not None else "")
        + f", from the residuals. {len(calibration.fits)} views"
        + "".join(f", {len(s.views)} {s.axis} photographs" for s in calibration.observations.sequences)
        + ". "
        + (
            f"The solve stopped after {calibration.solves} rounds because σ, weights and outliers had settled"
            if calibration.settled
            else f"The solve stopped at its limit of {calibration.solves} rounds, while outliers still changed"
        )
        + f"; its last round reached the minimum in {calibration.steps} steps."
    )
    units = [
        "px, 1/mm, mm per step",
        *(["of a tilt: radians"] if calibration.rig.camera.tilt else []),
        *(["of a bow: mm"] if any(light.kind == BowedSheet.kind for light in calibration.rig.lights) else []),
        *(["of what turns: radians per step, mm"] if diagnostics.turntables else []),
        *(["of given poses: radians, mm"] if calibration.hand else []),
    ]
    title = f"Parameters ({'; '.join(units)})"
    return Section(
        "The rig",
        paragraphs=(
            paragraph,
            *([f"Model: {calibration.choice.sentence}."] if calibration.choice is not None else []),
            *([f"In two parts: {calibration.parted.sentence}."] if calibration.parted is not None else []),
            *_shapes(calibration),
        ),
        tables=(Table(title, columns, tuple(rows)),),
    )


def _shapes(calibration: Calibration) -> list[str]:
    """What is tilted, curved or bent, in degrees and millimetres; a sentence for each."""
    camera, covariance, said = calibration.rig.camera, calibration.covariance, []
    if camera.tilt:
        degrees = np.degrees(np.linalg.norm([float(angle) for angle in camera.tilt]))
        said.append(f"The sensor is tilted by {degrees:.2f}° against the lens.")
    for light in light_summary(calibration.rig, covariance, image_rays(camera)):
        if "curved_mm" in light:
            error = "" if light["curved_mm_sigma"] is None else f" ± {light['curved_mm_sigma']:.2g}"
            said.append(
                f"The sheet of light{of_laser(light['name'])} is curved by {light['curved_mm']:.3f}{error} mm over "
                f"{2 * HALF_WIDTH_MM:g} mm in the middle of the image."
            )
    shape = shape_in_words(calibration.shape_facts())
    return said + ([f"The board is {shape}."] if shape else [])


def volume(volume: WorkingVolume) -> Section:
    """σ over the working volume."""
    caption = (
        "σ of a point along its ray over the part of the light sheet that the camera sees, between the nearest and "
        "the farthest stripe point of the calibration. Right: how much of it is the rig's (the same for all points "
        "nearby, so it does not average out) and how much the pixel's (independent from point to point). Outside this "
        "range σ grows."
    )
    picture = draw(f"working-volume{volume.laser and '-' + volume.laser}", caption, plots.volume(volume))
    return Section(f"How well a point is known{of_laser(volume.laser)}", figures=(picture,))


def photographs(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """Each photograph, and all of them in space."""
    rows = []
    for p in diagnostics.photographs:
        stripe = f"{p.stripe_rms_px:.3f}" if p.stripe_rms_px is not None else "–"
        corners = f"{p.corner_rms_px:.3f}" if np.isfinite(p.corner_rms_px) else "none fits"
        kept = f"{p.stripe_kept} of {p.stripe_points}" if p.stripe_points else "–"
        worst = f"{p.corner_worst_px:.2f}"
        where = "by motor" if p.staged else "by hand"
        rows.append((p.name, where, corners, worst, f"{p.corners_kept} of {p.corners}", stripe, kept))
    columns = ("photograph", "board moved", "corners RMS / px", "worst / px", "kept", "stripe RMS / px", "kept")
    caption = (
        "RMS of each photograph, the worst first"
        + (f" ({plots.MOST_PHOTOGRAPHS} of {len(rows)})" if len(rows) > plots.MOST_PHOTOGRAPHS else "")
        + "; dashed: the median of the corners. "
        + ("Pale bars are photographs on stage or turntable. " if calibration.moved_fits else "")
        + "A photograph that stands out was blurred, moved, bent, or does not belong."
    )
    title = "RMS distance of the corners that took part, and RMS error of the stripe"
    return Section(
        "Photograph by photograph",
        tables=(Table(title, columns, tuple(rows)),),
        figures=(
            draw("photographs", caption, plots.photographs(diagnostics.photographs)),
            draw(
                "scene",
                "Boards, stripes, light plane, stage and camera in space. The camera stands at the origin and looks "
                "along z. A board that stands where none was, or stripes beside the plane, would show here.",
                plots.scene(calibration, diagnostics, _points_in_space(calibration)),
            ),
        ),
    )


def residuals(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """Residuals over the image, by radius and against the normal."""
    size = calibration.rig.camera.image_size
    each = [("corner coordinates", diagnostics.corner_normality), ("stripe points", diagnostics.stripe_normality)]
    rows = tuple(
        (
            name,
            str(n.count),
            f"{n.skewness:+.2f}",
            f"{n.excess_kurtosis:+.2f}",
            f"{100 * n.beyond_2:.1f} %",
            f"{100 * n.beyond_3:.2f} %",
        )
        for name, n in each
        if n is not None
    )
    columns = ("residuals in σ", "count", "skewness", "excess kurtosis", "beyond 2 σ", "beyond 3 σ")
    normal = ("a normal distribution", "", "0", "0", "4.6 %", "0.27 %")
    return Section(
        "Residuals: what the model does not follow",
        tables=(Table("Against the normal", columns, (*rows, normal)),),
        figures=(
            draw(
                "residual-vectors",
                "Residuals (predicted minus seen) over the image: each corner pale, the mean of each cell four times "
                "as long, red where it is more than three standard errors of ten corners or more, pink where it may "
                "be noise. Noise points everywhere and no arrow is red; a lens that is not followed makes them swirl "
                "or point in or out.",
                plots.residual_vectors(diagnostics, size),
            ),
            draw(
                "histograms",
                "Residuals in units of their σ. Long tails are outliers that were not rejected or photographs of "
                "different quality; a shoulder is a bias.",
                plots.histograms(diagnostics.corner_normality, diagnostics.stripe_normality),
            ),
            draw(
                "radius",
                "Mean residual outwards against the distance from the principal point. A lens with too few terms "
                "leaves a wave that the bars do not cover.",
                plots.radius(diagnostics),
            ),
        ),
    )


def light(calibration: Calibration, volumes: tuple[WorkingVolume, ...], optics: Optics | None) -> Section | None:
    """What the photographs show of light and sensor, laser by laser; None where no detector has looked at them."""
    by_laser = {volume.laser: volume for volume in volumes}
    seen = [
        stripe for view in calibration.observations.photographs() for stripe in view.stripes if stripe.light is not None
    ]
    said = []
    for i, name in enumerate(calibration.observations.lasers):
        of_laser = [np.asarray(stripe.light, np.float32) for stripe in seen if stripe.laser == i]
        if (found := Light.of(of_laser)) is not None:
            said.append(f"In photographs of {laser_called(name)}, in the median: {found.in_words()}.")
            if optics is not None and name in by_laser:
                said.append(_limit(calibration, by_laser[name], optics, found.speckle_contrast))
    return Section("The light", paragraphs=tuple(said)) if said else None


def _limit(calibration: Calibration, volume: WorkingVolume, optics: Optics, contrast: float | None) -> str:
    """How near the pixels come to what speckle alone leaves, in words."""
    rays = volume_rays(calibration.rig, volume)
    points = rays / np.asarray(calibration.rig.light(volume.laser).inverse_depth(rays))[:, None]
    limit = limit_of(calibration.rig, points, optics, contrast, float(np.nanmedian(volume.pixel_mm)))
    return f"Speckle alone leaves {limit.in_words()}, along the ray in the median of the working volume."


def stripes(diagnostics: Diagnostics) -> Section:
    """The shape of each stripe."""
    rows = tuple(
        (
            f"{s.label} {s.laser}".strip(),
            str(len(s.along_px)),
            f"{s.offset_mm:+z.3f}",
            f"{s.tilt_mm:+z.3f}",
            f"{s.bend_mm:.3f}",
            f"{s.bend_of_noise_mm:.3f}",
            f"{s.noise_mm:.3f}",
        )
        for s in diagnostics.stripes
    )
    columns = (
        "photograph",
        "points",
        "offset / mm",
        "tilt / mm",
        "bend / mm",
        "bend of noise alone / mm",
        "noise / mm",
    )
    caption = (
        "Distance of each stripe from the sheet of light along the stripe, the most bent first (red: the running "
        "mean). A stripe on a board of the shape that was solved for is a level band about zero; a curve is a plate "
        "that is bent otherwise, an offset or tilt a wrong pose or pitch, a step the edge of something."
    )
    return Section(
        "Stripes on the boards",
        tables=(
            Table("Distance from the sheet of light in mm; bend: running mean from peak to valley", columns, rows),
        ),
        figures=(draw("stripes", caption, plots.stripes(diagnostics.stripes)),),
    )


def apart(diagnostics: Diagnostics) -> Section:
    """Halves and sessions."""
    figures, paragraphs = [], []
    each = [*([diagnostics.halves] if diagnostics.halves else []), *diagnostics.sessions]
    for i, a in enumerate(each):
        paragraphs.append(
            f"{a.parts[0][0].upper()}{a.parts[0][1:]} ({a.views[0]} views) and {a.parts[1]} ({a.views[1]} views): "
            f"they differ by {a.sigma_factor:.2f} times what their σ predict (√(χ²/n), n = {len(a.names)}; by chance "
            f"as much or more in {_percent(a.p)} of cases)."
        )
        caption = (
            "Differences of the two solutions in σ. About two thirds of the bars should lie within ± 1, and all but "
            "one in twenty in the pale band."
        )
        figures.append(draw(f"agreement-{i}", caption, plots.agreement(a)))
    if diagnostics.too_few_for_halves:
        paragraphs.append("There are too few photographs for two halves that give a rig each.")
    return Section("Parts of the photographs, solved apart", paragraphs=tuple(paragraphs), figures=tuple(figures))


def lens(tried: Ladder) -> Section:
    """The ladder."""
    rows = []
    for r in tried.rungs:
        gain = (
            f"{100 * r.gain:+.1f} ± {100 * (r.gain_error or 0):.1f} %"
            if r.gain is not None and np.isfinite(r.gain)
            else "–"
        )
        p = "–" if r.p is None else "< 0.0001" if r.p < 1e-4 else f"{r.p:.4f}"
        rows.append((r.lens, str(r.terms), _px(r.rms_px), _px(r.held_out_px), p, gain, "yes" if r.supported else "no"))
    columns = ("lens", "terms", "RMS / px", "held out RMS / px", "F-test p", "held-out gain", "supported")
    text = (
        f'The photographs support the lens "{tried.supported}"; this calibration has "{tried.chosen}". A rung is '
        "supported when against the best one below it the F-test gives p < 0.001 and the squared error of held-out "
        "views falls by more than two standard errors."
    )
    caption = (
        "Views that were fitted always fit better with more terms; views that were held out do not. Where the two "
        "lines part, terms fit noise."
    )
    return Section(
        "Which lens do the photographs support?",
        paragraphs=(text,),
        tables=(Table("The ladder, by corners alone", columns, tuple(rows)),),
        figures=(draw("ladder", caption, plots.ladder(tried)),),
    )


def coverage(calibration: Calibration, diagnostics: Diagnostics) -> Section:
    """What the photographs cover."""
    cover, words = diagnostics.coverage, []
    # A part of a session may have none.
    viewed = len(cover.distances_mm) > 0
    if viewed:
        words += [
            f"Boards: {len(cover.distances_mm)} views, {cover.distances_mm.min():.0f} to "
            f"{cover.distances_mm.max():.0f} mm away, tilted by {cover.tilts_deg.min():.0f}° to "
            f"{cover.tilts_deg.max():.0f}°, normals within {cover.tilt_spread_deg:.0f}° of each other.",
            f"Corners: in {100 * cover.image_share:.0f} % of the image, as far as {100 * cover.reach:.0f} % of the way "
            "from its centre to its corners.",
        ]
    for s in cover.stripes:
        words.append(
            f"Stripes{' of laser ' + s.laser if s.laser else ''}: {s.points} points on {s.views} boards, "
            f"{s.depths_mm[0]:.0f} to {s.depths_mm[1]:.0f} mm away, spread by {s.across_mm:.0f} mm within the sheet."
        )
    for axis, along in cover.axes.items():
        if along.way is not None:
            name = f"{axis[0].upper()}{axis[1:]}"
            words.append(f"{name}: {along.photographs} photographs over {along.way:.1f} {along.unit}.")
    caption = (
        "Where corners were seen (photographs in each part of the image tie the lens down there), how the boards were "
        "tilted (well spread is good), and how far away boards and stripes were."
    )
    return Section(
        "What the photographs cover",
        items=tuple(words),
        figures=(draw("coverage", caption, plots.coverage(diagnostics)),) if viewed else (),
    )


def left_out(calibration: Calibration) -> Section:
    """What was not used, and notes."""
    lines = (*calibration.notes, *calibration.left_out)
    rejected = Table(
        "Corners and stripe points of photographs that were used",
        ("rejected",),
        tuple((r,) for r in calibration.rejected),
    )
    return Section(
        "What was left out, and notes",
        items=lines or ("No photograph and no stripe was left out.",),
        tables=(rejected,) if calibration.rejected else (),
    )


def _points_in_space(calibration: Calibration) -> list[np.ndarray]:
    camera, poses, bent = calibration.rig.camera, calibration.photograph_poses(), calibration.bent_boards()
    return [
        stripe_points_in_space(calibration.observations, camera, poses, i, bent)[0]
        for i in range(len(calibration.rig.lights))
    ]


def _px(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else "no minimum"


def _percent(p: float) -> str:
    return "less than 0.1 %" if p < 1e-3 else f"{100 * p:.1f} %"
