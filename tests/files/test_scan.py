"""Scans: what the format allows, and every mistake with its fix."""

import dataclasses
from pathlib import Path

import pytest

from jaxscan.errors import InputError
from jaxscan.files.axes import StepRule
from jaxscan.files.scan import Scan, read_scan, write_scan
from jaxscan.files.table import PassedOverWarning
from jaxscan.images import StripeSettings

FRAMES = '[scan]\nframes = "frames/*.png"\n'
LISTED = '[scan]\nframes = ["frames/f1.png", "frames/f2.png"]\nsteps = [0, 1]\n'


@pytest.fixture
def folder(tmp_path: Path, photographs) -> Path:
    photographs(tmp_path / "frames", ["f10.png", "f2.png", "f1.png"])
    photographs(tmp_path, ["dark.png"])
    return tmp_path


def scan(folder: Path, *parts: str) -> Scan:
    (folder / "scan.toml").write_text("\n".join(parts))
    return read_scan(folder)


def frames(folder: Path) -> tuple[Path, ...]:
    return tuple(folder / "frames" / f"f{i}.png" for i in (1, 2, 10))


def test_the_least_scan(folder):
    expected = Scan(folder / "scan.toml", StripeSettings(), frames(folder), axes={"stage": (0, 2000, 4000)})
    assert scan(folder, FRAMES, "steps_per_frame = 2000") == expected
    assert read_scan(str(folder / "scan.toml")) == expected


def test_everything_that_the_format_has(folder):
    read = scan(
        folder,
        FRAMES,
        'steps = [-100000, 0, 7]\nbackground = "dark.png"\nexposures_s = [0.01, 0.04, 1]\nname = "cup"',
        '[laser]\nname = "left"\ncolor = "green"\ncolumns = false',
    )
    assert read == Scan(
        path=folder / "scan.toml",
        laser=StripeSettings(color="green", columns=False, name="left"),
        frames=frames(folder),
        axes={"stage": (-100_000, 0, 7)},
        backgrounds=(folder / "dark.png",),
        exposures_s=(0.01, 0.04, 1.0),
        name="cup",
    )


@pytest.mark.parametrize(
    ("background", "count"), [('"frames/*.png"', 3), ('["dark.png", "dark.png", "dark.png"]', 3), ('["dark.png"]', 1)]
)
def test_one_background_or_one_for_each_frame(folder, background, count):
    assert len(scan(folder, FRAMES, f"steps_per_frame = 1\nbackground = {background}").backgrounds) == count


def test_videos(folder):
    (folder / "scan.MP4").write_bytes(b"any")
    counted = scan(folder, '[scan]\nframes = "scan.MP4"\nsteps_per_frame = 5\nbackground = "dark.png"')
    assert (counted.video, counted.frames, counted.axes) == (folder / "scan.MP4", (), {})
    assert counted.rules == {"stage": StepRule(0, 5)}
    listed = scan(folder, '[scan]\nframes = "scan.MP4"\nsteps = [0, 5]\nexposures_s = [1, 2]')
    assert (listed.axes, listed.rules) == ({"stage": (0, 5)}, {})
    for read in (counted, listed):
        write_scan(read)
        assert read_scan(folder) == read


AXES = FRAMES + "[scan.axes]\n"


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("turntable = [0, 8, -3]", {"turntable": (0, 8, -3)}),
        ("turntable = { start = 16, per_frame = -8 }\nstage = 20000", {"turntable": (16, 8, 0), "stage": (20000,) * 3}),
        ("stage = { per_frame = 2000 }", {"stage": (0, 2000, 4000)}),
        ('"2" = 5\nz_lift-1 = [1, 2, 3]', {"2": (5, 5, 5), "z_lift-1": (1, 2, 3)}),
    ],
)
def test_axes_by_their_names(folder, written, read):
    got = scan(folder, AXES, written)
    assert (dict(got.axes), list(got.axes), got.rules) == (read, list(read), {})
    write_scan(got)
    text = (folder / "scan.toml").read_text()
    # The stage alone has its short form.
    assert ("steps = " in text, "[scan.axes]" in text) == ((True, False) if list(read) == ["stage"] else (False, True))
    assert read_scan(folder) == got
    assert list(read_scan(folder).axes) == list(read)


def test_an_axis_at_rest_is_written_as_one_number(folder):
    written = Scan(
        folder / "scan.toml", StripeSettings(), frames(folder), axes={"turntable": (0, 8, 16), "stage": (5, 5, 5)}
    )
    write_scan(written)
    assert "stage = 5\n" in (folder / "scan.toml").read_text()
    assert read_scan(folder) == written
    # A video has as many frames as a list has positions.
    (folder / "v.mp4").write_bytes(b"any")
    still = dataclasses.replace(written, frames=(), video=folder / "v.mp4", axes={"stage": (5, 5), "lift": (1, 1)})
    write_scan(still)
    assert read_scan(folder) == still


def test_axes_of_videos(folder):
    (folder / "v.mp4").write_bytes(b"any")
    video = '[scan]\nframes = "v.mp4"\n[scan.axes]\n'
    uncounted = scan(folder, video, "turntable = { start = 3, per_frame = 8 }\nstage = 20000")
    assert uncounted.rules == {"turntable": StepRule(3, 8), "stage": StepRule(20000, 0)}
    assert (uncounted.axes, uncounted.listed) == ({}, 0)
    # One list says how many frames there are.
    counted = scan(folder, video, "turntable = { per_frame = 8 }\nstage = [0, 0, 5, 5]")
    assert (counted.axes, counted.rules) == ({"turntable": (0, 8, 16, 24), "stage": (0, 0, 5, 5)}, {})
    from_three = scan(folder, video, "stage = { start = 3, per_frame = 8 }")
    for read in (uncounted, counted, from_three):
        write_scan(read)
        assert read_scan(folder) == read
    with pytest.raises(InputError, match=r"\[scan.axes\] b = \[1\]: 1 positions for 2 frames"):
        scan(folder, video, "a = [1, 2]\nb = [1]")


@pytest.mark.parametrize("count", [0, 1, 3])
def test_what_is_written_reads_the_same_however_early_it_was_cut_off(folder, count):
    for path in frames(folder)[count:]:
        path.unlink()
    written = Scan(
        path=folder / "scan.toml",
        laser=StripeSettings(color="blue", columns=False, name="left"),
        frames=frames(folder)[:count],
        axes={"stage": (-100_000, 0, 2000)[:count]},
        backgrounds=(folder / "dark.png",),
        exposures_s=(1 / 3, 0.04, 1.0)[:count],
        name='a "quoted" cup\n',
    )
    write_scan(written)
    assert read_scan(folder) == written
    assert '"frames/f1.png"' in (folder / "scan.toml").read_text() or not count
    least = dataclasses.replace(written, backgrounds=(), exposures_s=None, name="")
    write_scan(least)
    assert read_scan(folder) == least


def test_frames_that_are_not_listed_are_said(folder, photographs):
    photographs(folder / "frames", [f"g{i}.png" for i in range(5)])
    (folder / "frames" / "note.txt").write_text("no frame")
    with pytest.warns(PassedOverWarning, match=r"f10\.png, g0\.png, g1\.png and 3 more"):
        assert len(scan(folder, LISTED).frames) == 2
    # A glob leaves out on purpose; a background beside the frames is part of the scan.
    scan(folder, '[scan]\nframes = "frames/f*.png"\nsteps_per_frame = 1')
    for path in (folder / "frames").glob("g*"):
        path.unlink()
    scan(folder, LISTED, 'background = "frames/f10.png"')


@pytest.mark.parametrize(("name", "count"), [("stage-pyramid", 65), ("stage-flat", 9)])
def test_real_scans(data, name, count):
    read = read_scan(data / name)
    assert len(read.frames) == read.listed == count
    assert read.name == name.removeprefix("stage-")
    assert read.laser == StripeSettings(color="red", columns=False)


BAD = {
    "no scan": ("[laser]", ["scan", "is missing"]),
    "mistyped table": (FRAMES + "steps_per_frame = 1\n[lasers]", ["lasers", 'did you mean "laser"?']),
    "mistyped key": (FRAMES + "step_per_frame = 1", ["[scan] step_per_frame", 'did you mean "steps_per_frame"?']),
    "key of the session": (FRAMES + "steps_per_image = 1", ["[scan] steps_per_image", "steps_per_frame"]),
    "stripes": (FRAMES + 'steps_per_frame = 1\n[laser]\nstripes = "x"', ["[laser] stripes", "leave it out"]),
    "sheet": (FRAMES + 'steps_per_frame = 1\n[laser]\nsheet = "swept"', ["[laser] sheet", "leave it out", "the rig"]),
    "light's steps": (FRAMES + "steps_per_frame = 1\n[laser]\nstripe_steps = [1]", ["[laser] stripe_steps", "the rig"]),
    "light's axis": (FRAMES + 'steps_per_frame = 1\n[laser]\naxis = "sweep"', ["[laser] axis", "the rig"]),
    "two lasers": (FRAMES + "steps_per_frame = 1\n[[laser]]\n[[laser]]", ["laser", "must be a table"]),
    "no frames": ("[scan]\nsteps = [1]", ["[scan] frames", "is missing"]),
    "glob without files": ('[scan]\nframes = "f/*.png"\nsteps_per_frame = 1', ["[scan] frames", "matches no file"]),
    "missing frames": (
        LISTED.replace("f2", "f7").replace("f1", "f6"),
        ["[scan] frames", "2 of 2 files", "f6.png, f7.png"],
    ),
    "a frame twice": (LISTED.replace("f2", "f1"), ['"frames/f1.png" appears twice']),
    "steps of another number": (LISTED.replace("[0, 1]", "[0]"), ["[scan] steps = [0]", "1 step counts for 2 frames"]),
    "no steps": (FRAMES, ["[scan] steps", "steps_per_frame"]),
    "stands still": (FRAMES + "steps_per_frame = 0", ["steps_per_frame = 0", "does not move"]),
    "backgrounds": (LISTED + 'background = "frames/*.png"', ["[scan] background", "3 photographs for 2 frames"]),
    "no background": (LISTED + 'background = "light.png"', ["[scan] background", "matches no file"]),
    "exposures": (LISTED + "exposures_s = [0.1]", ["[scan] exposures_s", "1 exposure times for 2 frames"]),
    "no exposure": (LISTED + "exposures_s = [0.1, 0]", ["[scan] exposures_s", "longer than 0"]),
    "exposure as text": (LISTED + 'exposures_s = [0.1, "1/4"]', ["entry 1", "finite number"]),
    "nameless": (LISTED + 'name = ""', ["[scan] name", "not empty"]),
    "steps and axes": (
        FRAMES + "steps = [0, 1, 2]\n[scan.axes]\nturntable = 1",
        ["[scan] steps", "[scan.axes] is given"],
    ),
    "no axis": (AXES, ["[scan] axes = {}", "names no axis"]),
    "positions of another number": (
        AXES + "turntable = [0, 8]",
        ["[scan.axes] turntable = [0, 8]", "2 positions for 3 frames"],
    ),
    "an axis of spaces": (AXES + '"my table" = 1', ["[scan.axes] my table = 1", "letters, digits, _ and -"]),
    "an axis of no name": (AXES + '"" = 1', ["letters, digits, _ and -"]),
    "an axis in Greek": (AXES + '"θ" = 1', ["letters, digits, _ and -"]),
    "degrees": (AXES + "turntable = 1.5", ["[scan.axes] turntable = 1.5", "whole number"]),
    "a position as text": (AXES + 'turntable = "8"', ['[scan.axes] turntable = "8"', "per_frame = 8"]),
    "a start alone": (AXES + "turntable = { start = 8 }", ["[scan.axes] turntable", "no per_frame", "turntable = 8"]),
    "parts of steps": (FRAMES + "steps_per_frame = 40.4", ["steps_per_frame = 40.4", "steps = [0, 40, 81, 121, …]"]),
    "parts of steps of an axis": (
        AXES + "turntable = { per_frame = -0.5 }",
        ["turntable.per_frame = -0.5", "list them all: turntable = [0, 0, -1, -2, …]"],
    ),
    "an axis at rest": (AXES + "turntable = { per_frame = 0 }", ["turntable.per_frame = 0", "does not move"]),
    "a mistyped rule": (
        AXES + "turntable = { begin = 8, per_frame = 1 }",
        ["[scan.axes] turntable.begin", "start, per_frame"],
    ),
    "poses": (FRAMES + 'poses = "poses.csv"', ['[scan] poses = "poses.csv"', "is no file", "the pose of each frame"]),
    "no video": ('[scan]\nframes = "a.mp4"\nsteps_per_frame = 1', ["[scan] frames", "matches no file"]),
    "exposures of a video": (
        '[scan]\nframes = "v.avi"\nsteps_per_frame = 1\nexposures_s = [1]',
        ["[scan] exposures_s", "list its positions"],
    ),
    "two videos": ('[scan]\nframes = "*.avi"\nsteps_per_frame = 1', ["[scan] frames", "matches 2 videos"]),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named_with_their_mend(folder, name):
    for video in ("v.avi", "w.avi"):
        (folder / video).write_bytes(b"any")
    text, expected = BAD[name]
    with pytest.raises(InputError) as caught:
        scan(folder, text)
    message = str(caught.value)
    assert message.startswith(f"{folder / 'scan.toml'}: ")
    for part in expected:
        assert part in message
