"""A scan as a stream: photographs are decoded, measured and triangulated some at a time, while the next are decoded.

The points of a frame are the same whatever is looked at together with it, and memory is the same whatever the length.
"""

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np
from jaxtyping import Int

from jaxscan.axis_details import is_detail
from jaxscan.deadline import in_turn
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector, check_detector
from jaxscan.errors import InputError, error_context
from jaxscan.files.place_checks import doubts
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import Stripe, StripeSettings
from jaxscan.images.decode import Image
from jaxscan.images.hot_pixels import HotPixels
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.images.stripes.brightest import miscoloured
from jaxscan.images.stripes.coherent import HALO
from jaxscan.images.stripes.colourless import check_colours
from jaxscan.images.stripes.validity import Verdict
from jaxscan.reconstruction.background_watch import BackgroundWatch
from jaxscan.reconstruction.frames import Frames, frames_of, frames_of_scan, with_positions
from jaxscan.reconstruction.light_watch import LightWatch
from jaxscan.reconstruction.merged_steps import merged_steps, step_groups
from jaxscan.reconstruction.odd_frames import frame_names
from jaxscan.reconstruction.order_watch import OrderWatch
from jaxscan.reconstruction.overlapping import overlapping
from jaxscan.reconstruction.pose_notes import check_poses, pose_notes
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.reconstruction.ready_laser import ReadyLaser
from jaxscan.reconstruction.repeat_watch import RepeatWatch
from jaxscan.reconstruction.scan_checks import check_axes, check_lines, check_scan, sweep_notes, way_notes
from jaxscan.reconstruction.scan_colours import object_stands
from jaxscan.reconstruction.scan_notes import (
    REASONS,
    background_notes,
    brighter_colors,
    channels_note,
    gap_notes,
    in_another_colour,
    left_out_notes,
    order_notes,
)
from jaxscan.reconstruction.sheet_band import check_depths, depths_of
from jaxscan.reconstruction.sight_watch import SightWatch
from jaxscan.reconstruction.spacetime import half_window
from jaxscan.reconstruction.spacetime_geometry import coarse_notes, spacetime_geometry
from jaxscan.reconstruction.thick_sheet import Looked
from jaxscan.reconstruction.turns import two_frames, with_ends, with_runs
from jaxscan.rig import MovingLight, Positions, Rig, played_axes, run_of
from jaxscan.rig.play import Runs
from jaxscan.rig.stripe_way import steep_notes

# Each has a buffer of its own.
_MOST_AT_ONCE: Final = 4

Counted = tuple[RangeImage, Int[np.ndarray, "verdicts"]]


class Scanner:
    """A rig and how its stripes are searched, prepared for any number of scans.

    Args:
        rig: as `read_rig` gives it; with its covariance the points carry their σ.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        spacetime: measure the time at which the light's centre passes each point; needs scans in small, equal steps.
        depths_mm: nearest and farthest depth (`sheet_band`) at which there can be a stripe, mm; by default that
            of the rig's calibration, widened; (0, inf) for any. Spacetime analysis looks everywhere.
        decoders: how many threads decode photographs; as many as the machine has cores by default.
        at_once: how many batches of photographs are measured together; by default as many as the machine has cores, up
            to four. Each needs a buffer of its own; the points are the same.

    Attributes:
        notes: what the photographs of the last scan have shown to be wrong in its settings.
        left_out: how many lines of the last scan's frames have no point although something is bright in them, for each
            reason of `REASONS`.

    Notes and counts are those of the scan that ended last: threads that share one take a `copy.copy` of it each.

    Raises:
        InputError: the depths are none, there is no such detector, or a number of threads is below 1.
    """

    def __init__(
        self,
        rig: RigFile | Rig,
        detector: Detector = DEFAULT,
        choice: Choice = DEFAULT_CHOICE,
        spacetime: bool = False,
        depths_mm: tuple[float, float] | None = None,
        *,
        decoders: int | None = None,
        at_once: int | None = None,
    ) -> None:
        check_detector(detector)
        if depths_mm is not None:
            check_depths(depths_mm)
        for name, count in (("decoders", decoders), ("at_once", at_once)):
            if count is not None and count < 1:
                raise InputError(f"{name} is {count}: give 1 or more, or None for as many as the machine has cores")
        self._content = rig if isinstance(rig, RigFile) else RigFile(rig)
        self.warnings = self._content.warnings
        self._detector: Detector = detector
        self._choice: Choice = choice
        self._spacetime = spacetime
        self._depths_mm = depths_of(self._content) if depths_mm is None else depths_mm
        self._decoders = decoders
        self._at_once = at_once or min(os.cpu_count() or 1, _MOST_AT_ONCE)
        self._ready: dict[StripeSettings, ReadyLaser] = {}
        self.notes: list[str] = []
        self.left_out: dict[str, int] = {}

    def scan(self, scan: Scan, advance: Callable[[int], object] = lambda by: None) -> Iterator[RangeImage]:
        """The range image of a scan, some frames at a time, in their order.

        Args:
            scan: as `read_scan` gives it.
            advance: called with the number of photographs that have been read.

        Raises:
            InputError: the scan does not fit the rig, a photograph cannot be read or is unlike the others, the scan has
                no frames, or there is no stripe in any of them.
        """
        rig = self._content.rig
        check_scan(rig, scan)
        check_poses(self._content, scan)
        with error_context(scan.path):
            laser, light = self._laser(scan.laser), rig.light(scan.laser.name)
        check_lines(rig, scan.laser, f"{scan.path}: [laser] columns = {str(scan.laser.columns).lower()}")
        frames = seen = points = 0
        self.notes, self.left_out = [], {}
        notes = [*way_notes(rig, scan), *doubts(scan.checks), *gap_notes(scan), *order_notes(scan)]
        beyond = sweep_notes(self._content, scan)
        notes += steep_notes(rig, scan.laser.name, "over the image by this rig", columns=scan.laser.columns)
        notes += [*beyond, *background_notes(rig, scan), *pose_notes(self._content, scan)]
        verdicts, watch, order = np.zeros(len(Verdict), int), LightWatch(), OrderWatch(rig.motion)
        sight = SightWatch(rig.motion, [other for other in rig.lights if other is not light])
        # Whoever stops early stops the reader too.
        with ExitStack() as to_close:
            for image, counts in self._images(laser, scan, advance, watch, notes, to_close):
                frames += len(image.valid)
                verdicts += counts
                seen += int(np.isfinite(image.pixels).sum())
                points += int(image.valid.sum())
                order.see(image.pixels, image.positions)
                if not self._spacetime:
                    # Points of a moment between frames are in the sheet of none.
                    sight.see(image)
                yield image
        if not frames:
            raise InputError(f"{scan.path}: the scan has no frames")
        left_out = {reason: int(verdicts[verdict]) for verdict, reason in REASONS.items()}
        swept_by = light.axis if isinstance(light, MovingLight) and light.axis in scan.axis_names else None
        last = left_out_notes(left_out, points, self._depths_mm, swept_by)
        last += watch.notes(scan.exposures_s is not None, bool(scan.backgrounds), scan.laser.color == "grey")
        last += order.notes([] if self._spacetime else frame_names(scan, frames)) + sight.notes()
        if not seen:
            raise InputError(
                # A light that stands elsewhere than its steps say is looked for where it is not, in any colour.
                f"{scan.path}: no stripe was found in any of {frames} frames"
                f"{'' if beyond else in_another_colour(scan)}: {''.join(f'{note}; ' for note in beyond)}check [laser] "
                f'color ("{scan.laser.color}") and columns ({str(scan.laser.columns).lower()}), and look at one with '
                "jaxscan inspect SCAN --frame 0 --png" + "".join(f"; {note}" for note in last)
            )
        self.notes, self.left_out = notes + last, left_out
        if not points:
            raise InputError(
                f"{scan.path}: a stripe was found, but no ray through it meets the rig's light plane within its lens: "
                "check that the rig is that of this scan" + "".join(f"; {note}" for note in beyond)
            )

    def frames(
        self,
        frames: Iterable[tuple[Image, Positions | int]],
        laser: StripeSettings | None = None,
        background: Image | None = None,
        batch: int = 1,
        *,
        whole: bool = False,
    ) -> Iterator[RangeImage]:
        """The points of photographs as they arrive from a camera that is scanning.

        If the first of them show their stripe in another colour than the laser's, as photographs of OpenCV do, which
        are blue, green and red, there is a warning, and a note in `notes`.

        Args:
            frames: each photograph, (rows, columns) or (rows, columns, 3) with red, green and blue, and the positions
                of the axes by their names, motor steps; or the step count of the stage.
            laser: which, and how its stripe is looked for; the default is one red laser, and a point for each column.
            background: the scene with the laser off.
            batch: how many photographs are waited for before they are looked at; the points do not depend on it, but
                for those of an axis with play until it first moves: unless that is in the same batch they stand in the
                middle of the play.
            whole: whether they are a scan, whose points are moved to the middle of a sheet of light that has a
                thickness (`thick_sheet`), as those of a scan in files are. That takes frames behind each, for which it
                waits, and a batch of two at the least.

        Raises:
            InputError: a photograph is not of the rig's size, or unlike the first, its positions are not those of
                the rig's axes, or those of a coloured laser have no colours.
        """
        settings = laser or StripeSettings()
        ready = self._laser(settings)
        check_lines(self._content.rig, settings, f"laser: columns={settings.columns}")
        found = self._looked(ready, frames, settings, background, batch)
        if whole and (begin := next(found, None)) is not None:
            two = {axis: np.asarray(steps)[:2] for axis, steps in begin[0].positions.items()}
            found = ready.middles(chain((begin,), found), ready.frames_apart(two if len(begin[0].valid) > 1 else None))
        for image, _ in found:
            yield image

    def _looked(
        self,
        ready: ReadyLaser,
        frames: Iterable[tuple[Image, Positions | int]],
        settings: StripeSettings,
        background: Image | None,
        batch: int,
    ) -> Iterator[Looked]:
        """The points of photographs in memory, and their stripes."""
        self.notes, self.left_out = [], {}
        first, looked, played = None, False, {axis: Runs() for axis in played_axes(self._content.rig.motion)}
        for some, axes in frames_of(with_positions(frames), background, self._content.rig.camera.image_size, batch):
            if first is None:
                first = some.positions[0]
                check_colours(some.photographs, settings.color, "frame 0")
            moved = (some.positions != first).any(axis=0)
            moving = [axis for axis, each in zip(axes, moved, strict=True) if each and not is_detail(axis)]
            check_axes(self._content.rig, moving, axes, "frames:", settings.name)
            image, stripe = ready.range_image(*_with_runs(some, axes, played))
            if not looked:
                looked = True
                if (note := channels_note(some.images[: len(image.valid)], image.pixels, settings)) is not None:
                    self.notes.append(note)
                    warnings.warn(note, stacklevel=3)
            yield image, stripe

    def _images(
        self,
        laser: ReadyLaser,
        scan: Scan,
        advance: Callable[[int], object],
        watch: LightWatch,
        notes: list[str],
        to_close: ExitStack,
    ) -> Iterator[Counted]:
        """Range images, and how many lines of each had which verdict; `watch` and `notes` are updated.

        The reader of the photographs is one of what is `to_close`.
        """
        rig = self._content.rig
        passage = spacetime_geometry(rig, scan) if self._spacetime else None
        if passage is not None:
            notes += coarse_notes(*passage)
        halo = HALO if self._choice == "coherent" else 0
        # Where a turn closes, its first frames have neighbours before them, and its last behind them.
        apart = 0 if passage is not None else laser.frames_apart(two_frames(with_runs(scan, rig.motion)))
        looked_at = max(halo, apart) if passage is None else half_window(passage[1])
        longer, before = with_ends(scan, rig.motion, looked_at, equal=self._spacetime)
        longer = with_runs(longer, rig.motion)
        own, done = range(before, before + (len(step_groups(scan)) or sys.maxsize)), 0
        # Passages are looked at one batch after the other.
        kept = self._at_once if passage is None else 1
        read = frames_of_scan(longer, rig.camera.image_size, self._decoders, kept)
        read = to_close.enter_context(closing(read))
        repeats, hot, shift = RepeatWatch(), HotPixels(scan.laser.columns), BackgroundWatch(longer)
        watchers = [shift.see, lambda some: repeats.see(some.photographs)]
        if not scan.backgrounds:
            # A laser-off photograph has the hot pixels too.
            watchers.append(lambda some: hot.correct(some.photographs))
        seen = _shown(read, watchers)
        batches = self._batches(longer, seen, halo, _at_most(advance, len(scan.frames) or sys.maxsize))
        found: Iterator[tuple[RangeImage, Stripe | None]]
        if passage is None:
            found = laser.middles(self._stripes(laser, longer, batches, notes), apart)
        else:
            found = laser.passages(*passage, batches, longer.axis_names)
        for image, stripe in found:
            here, done = _part_of(own, done, len(image.valid)), done + len(image.valid)
            if here.start == here.stop:
                continue
            counts = np.zeros(len(Verdict), int)
            if stripe is not None:
                watch.see(stripe[here])
                counts = np.bincount(stripe[here].verdict.ravel(), minlength=len(Verdict))
            yield image[here, :], counts
        notes += repeats.notes(longer.frames) + hot.notes() + shift.notes()

    def _batches(
        self, scan: Scan, read: Iterable[Frames], halo: int, advance: Callable[[int], object]
    ) -> Iterator[Frames]:
        """What is read; the exposures of a step merged; neighbours in time at hand: each where it is asked for."""
        read = _told(read, advance)
        several = scan.exposures_s is not None and len(set(scan.positions)) < scan.listed
        merged = merged_steps(scan, read, FRAMES_AT_ONCE) if several else read
        if self._spacetime or not (several or halo):
            return merged
        # Merged steps come in batches of any size: they get one here, so that the last of them compiles nothing again.
        return overlapping(merged, halo, halo, FRAMES_AT_ONCE - 2 * halo)

    def _stripes(self, laser: ReadyLaser, scan: Scan, batches: Iterable[Frames], notes: list[str]) -> Iterator[Looked]:
        """The stripe of each frame by itself, and its points; `notes` is updated."""
        looked, standing = False, object_stands(self._content.rig, scan)

        def measured(some: Frames) -> tuple[RangeImage, Stripe]:
            with error_context(scan.path):
                return laser.range_image(some, scan.axis_names, standing)

        for some, (image, stripe) in in_turn(measured, batches, self._at_once, f"{scan.path}: its stripes"):
            if not looked and np.isfinite(image.pixels).any():
                looked = True
                notes += _miscoloured(scan.laser, some, image)
            yield image[some.inner, :], stripe[some.inner]

    def _laser(self, settings: StripeSettings) -> ReadyLaser:
        if settings not in self._ready:
            self._ready[settings] = ReadyLaser(self._content, settings, self._detector, self._choice, self._depths_mm)
        return self._ready[settings]


def _miscoloured(laser: StripeSettings, frames: Frames, found: RangeImage) -> list[str]:
    """Whether the stripe has another colour than it is looked for."""
    said = miscoloured(brighter_colors(frames.images[: len(found.pixels)], found.pixels, laser), laser)
    return [] if said is None else [f"the stripe {said} in scan.toml"]


def _with_runs(frames: Frames, axes: Sequence[str], played: Mapping[str, Runs]) -> tuple[Frames, tuple[str, ...]]:
    """Frames with the runs of axes that have play among their positions, and the names of all these."""
    new = [axis for axis in played if axis in axes and run_of(axis) not in axes]
    columns = [played[axis].of(frames.positions[:, axes.index(axis)])[:, None] for axis in new]
    positions = np.concatenate([frames.positions, *columns], axis=1)
    return replace(frames, positions=positions), (*axes, *map(run_of, new))


def _part_of(own: range, done: int, count: int) -> slice:
    """Which of the `count` frames from number `done` on are a scan's own."""
    return slice(min(max(own.start - done, 0), count), min(max(own.stop - done, 0), count))


def _at_most(advance: Callable[[int], object], most: int) -> Callable[[int], object]:
    """Report progress, up to `most` frames in all."""
    left = most

    def told(by: int) -> None:
        nonlocal left
        advance(min(by, left))
        left -= min(by, left)

    return told


def _shown(frames: Iterable[Frames], watchers: Sequence[Callable[[Frames], None]]) -> Iterator[Frames]:
    """The frames, after each of those who watch has seen them."""
    for some in frames:
        for each in watchers:
            each(some)
        yield some


def _told(frames: Iterable[Frames], advance: Callable[[int], object]) -> Iterator[Frames]:
    for some in frames:
        yield some
        advance(len(some.positions))
