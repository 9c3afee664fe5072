"""The stream: the same points whatever is looked at together, from files of any kind and from a camera as they come."""

import threading
from collections import deque
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.images.stripes.candidates import candidates
from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
from jaxscan.images.stripes.coherent import HALO
from jaxscan.images.stripes.windows import gather_pixels
from jaxscan.reconstruction import Scanner, frames, reconstruct, write_stream
from jaxscan.reconstruction.range_image import RangeImage, read_range_image
from jaxscan.rig import Covariance
from jaxscan.rig.rig import parameter_names
from tests.reconstruction.small import small_rig, wavy_stripe

COUNT = 7
GREY = StripeSettings("grey")


@pytest.fixture(scope="module")
def rig() -> RigFile:
    rig = small_rig()
    names = tuple(parameter_names(rig))
    return RigFile(rig, Covariance(names, np.diag(np.full(len(names), 1e-8))), {"stripe_sigma_ratio": 1.25})


@pytest.fixture(scope="module")
def photographs() -> np.ndarray:
    random = np.random.default_rng(0)
    levels = np.stack([wavy_stripe(i) for i in range(COUNT)])
    return np.rint(levels + 2 * random.standard_normal(levels.shape)).clip(0, 255).astype(np.uint8)


def scan_of(folder: Path, images: np.ndarray, ending: str, **more) -> Scan:
    paths = tuple(folder / f"{i:03d}{ending}" for i in range(len(images)))
    for path, image in zip(paths, images, strict=True):
        if ending == ".npy":
            np.save(path, image)
        else:
            write_image(path, image)
    return Scan(folder / "scan.toml", GREY, paths, axes={"stage": tuple(range(0, 1000 * len(images), 1000))}, **more)


def assert_same(a: RangeImage, b: RangeImage) -> None:
    for name in ("points", "pixels", "strength", "valid", "steps"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for name in ("sigma", "sigma_pixel"):
        # Compiled for another shape, a sum may be rounded once more or less.
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-6, err_msg=name)


@pytest.fixture(scope="module")
def whole(rig: RigFile, photographs: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> RangeImage:
    return reconstruct(rig, scan_of(tmp_path_factory.mktemp("png"), photographs, ".png"), detector="gravity")


def test_every_frame_has_its_points(whole):
    assert whole.valid.mean() > 0.95
    assert (whole.sigma[whole.valid] >= whole.sigma_pixel[whole.valid]).all()
    np.testing.assert_array_equal(whole.steps, np.arange(0, 7000, 1000))


@pytest.mark.parametrize("batch", [1, 3])
def test_points_do_not_depend_on_the_batch(rig, photographs, whole, batch):
    steps = [int(n) for n in whole.steps]
    pairs = zip(photographs, steps, strict=True)
    parts = list(Scanner(rig, "gravity").frames(pairs, GREY, batch=batch))
    assert [len(part.steps) for part in parts] == ([1] * 7 if batch == 1 else [3, 3, 1])
    assert_same(RangeImage.joined(parts), whole)


def test_a_camera_is_not_waited_for(rig, photographs):
    """Each frame's points are there before the next photograph is taken."""
    taken = []

    def camera():
        for i, image in enumerate(photographs):
            taken.append(i)
            yield image, i

    for i, _ in enumerate(Scanner(rig, "gravity").frames(camera(), GREY)):
        assert taken == list(range(i + 1))


@pytest.mark.parametrize("ending", [".tif", ".npy", ".bmp"])
def test_files_of_other_kinds(rig, photographs, whole, tmp_path, ending):
    assert_same(reconstruct(rig, scan_of(tmp_path, photographs, ending), detector="gravity"), whole)


def test_a_ring_of_buffers_keeps_frames_and_backgrounds_in_step(rig, photographs, tmp_path, monkeypatch):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 2)
    random = np.random.default_rng(1)
    dark = random.integers(0, 50, photographs.shape, dtype=np.uint8)
    folders = tmp_path / "lit", tmp_path / "dark"
    for folder in folders:
        folder.mkdir()
    own = scan_of(folders[1], dark, ".png").frames
    scan = scan_of(folders[0], (photographs // 2 + dark).astype(np.uint8), ".png", backgrounds=own)
    with_backgrounds = reconstruct(rig, scan, detector="gravity")
    scanner = Scanner(rig, "gravity")
    alone = [
        next(scanner.frames([(lit, 1000 * i)], GREY, background))
        for i, (lit, background) in enumerate(zip(photographs // 2 + dark, dark, strict=True))
    ]
    assert_same(with_backgrounds, RangeImage.joined(alone))


@pytest.mark.parametrize("kept", [1, 3])
def test_frames_that_were_given_out_stay_as_they_are(photographs, tmp_path, monkeypatch, kept):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 1)
    scan, last = scan_of(tmp_path, np.concatenate([photographs] * 3), ".png"), deque(maxlen=kept)
    for i, some in enumerate(frames.frames_of_scan(scan, photographs.shape[:0:-1], kept=kept)):
        last.append(some)
        for k, one in enumerate(reversed(last)):
            np.testing.assert_array_equal(one.images[0], photographs[(i - k) % COUNT])


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_points_do_not_depend_on_how_many_are_measured_together(
    rig, photographs, whole, tmp_path, monkeypatch, at_once
):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 2)
    scan = scan_of(tmp_path, photographs, ".png")
    assert_same(RangeImage.joined(list(Scanner(rig, "gravity", at_once=at_once).scan(scan))), whole)


@pytest.mark.parametrize("count", [0, -1])
@pytest.mark.parametrize("name", ["decoders", "at_once"])
def test_threads_that_are_none_are_refused(rig, name, count):
    with pytest.raises(InputError, match=f"{name} is {count}: give 1 or more"):
        Scanner(rig, "gravity", **{name: count})


def test_a_reader_that_stops_leaves_no_thread(rig, photographs, tmp_path, monkeypatch):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 1)
    before = threading.active_count()
    stream = Scanner(rig, "gravity").scan(scan_of(tmp_path, photographs, ".png"))
    next(stream)
    stream.close()
    assert threading.active_count() == before


def test_files_are_written_as_frames_are_read(rig, photographs, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 2)
    outputs = [tmp_path / "out.npz", tmp_path / "out.ply"]
    done = write_stream(outputs, Scanner(rig, "gravity").scan(scan_of(tmp_path, photographs, ".png")))
    assert (done.frames, done.empty, done.points) == (7, 0, whole.valid.sum())
    assert_same(read_range_image(outputs[0]), whole)
    back = read_range_image(outputs[0])
    assert jax.tree.leaves((whole.motion, whole.sheets)) == jax.tree.leaves((back.motion, back.sheets))
    from jaxscan.files.cloud import read_ply

    cloud = read_ply(outputs[1])
    np.testing.assert_array_equal(cloud.points, whole.points[whole.valid])
    np.testing.assert_allclose(cloud.sigma, whole.sigma[whole.valid], rtol=1e-6)


def test_a_frame_that_is_cut_short_is_named_and_nothing_is_written(rig, photographs, tmp_path, monkeypatch):
    monkeypatch.setattr(frames, "FRAMES_AT_ONCE", 2)
    scan = scan_of(tmp_path, photographs, ".png")
    scan.frames[5].write_bytes(scan.frames[5].read_bytes()[:500])
    with pytest.raises(InputError, match=r"005.png.*cut off"):
        write_stream([tmp_path / "out.ply"], Scanner(rig, "gravity").scan(scan))
    assert not [path for path in tmp_path.iterdir() if path.suffix in (".ply", ".part")]


def test_a_frame_that_is_missing_is_named(rig, photographs, tmp_path):
    scan = scan_of(tmp_path, photographs, ".png")
    scan.frames[3].unlink()
    with pytest.raises(InputError, match=r"003.png"):
        reconstruct(rig, scan, detector="gravity")


def test_an_axis_that_the_rig_lacks_is_refused(rig, photographs, tmp_path):
    scan = scan_of(tmp_path, photographs, ".png")
    still = replace(scan, axes={**scan.axes, "turntable": (3,) * COUNT})
    assert_same(reconstruct(rig, scan, detector="gravity"), reconstruct(rig, still, detector="gravity"))
    with pytest.raises(
        InputError, match=r"the turntable moves between frames, but the rig has no such axis, it has stage"
    ):
        reconstruct(rig, replace(scan, axes={**scan.axes, "turntable": tuple(range(COUNT))}))


@pytest.mark.parametrize(
    ("positions", "says"),
    [
        ([{"turntable": 0}, {"turntable": 5}], "frames: the turntable moves between frames, but the rig has no such"),
        (
            [{"stage": 0}, {"stage": 5, "turntable": 5}],
            "frame 1: has positions of stage, turntable, the first frame of",
        ),
        ([{"stage": 0, "turntable": 0}, {"stage": 5}], "frame 1: has positions of stage, the first frame of stage, t"),
        ([{"stage": 0}, {}], "frame 1: has positions of no axis"),
        ([{"stage": 0}, {"stage": 0.5}], "frame 1: stands at stage 0.5: give whole motor steps"),
        ([0, float("nan")], "frame 1: stands at stage nan: give whole"),
        ([0, "8"], "frame 1: stands at stage 8: give whole"),
    ],
)
@pytest.mark.parametrize("batch", [1, 2])
def test_frames_as_they_come_stand_where_the_rig_knows(rig, photographs, positions, says, batch):
    with pytest.raises(InputError, match=says):
        list(Scanner(rig, "gravity").frames(zip(photographs[:2], positions, strict=True), GREY, batch=batch))


def test_the_sigma_of_a_pixel_is_the_detectors_scaled_by_what_boards_have_shown(rig, photographs):
    calibrated, plain = (
        next(Scanner(r, "gravity").frames([(photographs[0], 0)], GREY))
        for r in (rig, RigFile(rig.rig, rig.covariance, {}))
    )
    np.testing.assert_allclose(calibrated.sigma_pixel, 1.25 * plain.sigma_pixel, rtol=1e-5)


def test_jpegs_are_those_of_opencv(tmp_path):
    random = np.random.default_rng(0)
    for shape in ((33, 50, 3), (33, 50)):
        image = cv2.GaussianBlur(random.integers(0, 255, shape, dtype=np.uint8), (5, 5), 1)
        path = tmp_path / f"{len(shape)}.jpg"
        write_image(path, image)
        flag = cv2.IMREAD_COLOR_RGB if len(shape) == 3 else cv2.IMREAD_GRAYSCALE
        from jaxscan.images import read_image

        np.testing.assert_array_equal(read_image(path), cv2.imread(str(path), flag))
        out = np.empty(shape, np.uint8)
        assert read_image(path, out) is out
        np.testing.assert_array_equal(out, read_image(path))


@pytest.mark.parametrize(("said", "notes"), [("green", 1), ("red", 0)])
def test_a_stripe_of_another_colour_than_was_said_is_pointed_out(rig, photographs, tmp_path, said, notes):
    # A white surface throws a little of a red laser's light into the green channel.
    short = np.where(np.arange(photographs.shape[2]) < 32, photographs, 20)
    coloured = np.stack([short, 20 + 0.3 * short, np.full(short.shape, 20)], axis=-1).astype(np.uint8)
    scan = replace(scan_of(tmp_path, coloured, ".png"), laser=StripeSettings(said))
    scanner = Scanner(rig, "gravity")
    assert sum(image.valid.sum() for image in scanner.scan(scan))
    assert len(scanner.notes) == notes
    assert all('set color = "red"' in note for note in scanner.notes)


@pytest.mark.parametrize("color", ["red", "blue"])
def test_three_equal_channels_are_no_colours(rig, photographs, tmp_path, color):
    images = np.repeat(photographs[..., None], 3, axis=-1)
    laser = StripeSettings(color)
    with pytest.raises(InputError, match=rf'000\.png: .*laser\'s colour is {color}: write color = "grey"'):
        reconstruct(rig, replace(scan_of(tmp_path, images, ".png"), laser=laser))
    with pytest.raises(InputError, match=r'frame 0: red, green and blue are equal in every pixel.* color = "grey"'):
        next(Scanner(rig, "gravity").frames([(images[0], 0)], laser))


def test_photographs_in_memory_are_a_range_image(rig, photographs, whole):
    counted: list[int] = []
    frames = ((photograph, 1000 * i) for i, photograph in enumerate(photographs))
    assert_same(reconstruct(rig, frames, counted.append, "gravity", laser=GREY), whole)
    assert sum(counted) == COUNT
    with pytest.raises(InputError, match="no photographs"):
        reconstruct(rig, [])
    with pytest.raises(InputError, match="spacetime"):
        reconstruct(rig, [], spacetime=True)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            lambda photographs: iter(photographs),
            r"frame 0: is an array of shape \(\d+, \d+\), without motor steps: .*zip",
        ),
        (lambda photographs: iter([(photographs[0],)]), "frame 0: is a tuple, without motor steps"),
        (lambda photographs: iter([(photographs[0], 0), ("1.png", 0)]), "frame 1: its photograph is '1.png', and no"),
        (lambda photographs: "scan", r'read_scan\("scan"\)'),
        (lambda photographs: None, "NoneType: give pairs"),
    ],
    ids=["no steps", "one value", "a name", "a folder", "nothing"],
)
def test_photographs_without_their_steps_are_refused_with_the_way_to_give_them(photographs, given, says):
    with pytest.raises(InputError, match=says):
        list(frames.with_positions(given(photographs)))


@pytest.mark.parametrize("bright", [True, False], ids=["a little red too", "no red at all"])
def test_photographs_that_opencv_has_read_are_recognised(rig, photographs, bright):
    rgb = np.stack([photographs, *2 * [np.full(photographs.shape, 20)]], axis=-1).astype(np.uint8)
    if bright:
        rgb[..., 2] = 20 + 0.2 * (rgb[..., 0].astype(float) - 20)
    assert reconstruct(rig, zip(rgb, range(0, 7000, 1000), strict=True), detector="gravity").valid.any()
    scanner = Scanner(rig, "gravity")
    with pytest.warns(UserWarning, match=r"show it in blue: .* BGR, with image\[\.\.\., ::-1\]"):
        list(scanner.frames(zip(rgb[..., ::-1], range(0, 7000, 1000), strict=True), batch=COUNT))
    assert len(scanner.notes) == 1


def test_laser_and_background_are_for_photographs_in_memory(rig, photographs, tmp_path):
    with pytest.raises(InputError, match=r"scan\.toml names those"):
        reconstruct(rig, scan_of(tmp_path, photographs, ".png"), laser=GREY)


def test_notes_of_two_scans_at_once_are_not_mixed(rig, photographs, tmp_path):
    short = np.where(np.arange(photographs.shape[2]) < 32, photographs, 20)
    coloured = np.stack([short, 20 + 0.3 * short, np.full(short.shape, 20)], axis=-1).astype(np.uint8)
    wrong = replace(scan_of(tmp_path, np.concatenate([coloured] * 4), ".png"), laser=StripeSettings("green"))
    right = replace(wrong, laser=StripeSettings("red"))
    scanner = Scanner(rig, "gravity")
    first, second = scanner.scan(wrong), scanner.scan(right)
    next(first)
    next(second)
    assert sum(image.valid.sum() for image in first)
    assert ['set color = "red"' in note for note in scanner.notes] == [True]
    assert sum(image.valid.sum() for image in second)
    assert scanner.notes == []


@pytest.mark.parametrize("mode", [{"choice": "coherent"}, {"exposures": True}])
def test_a_scan_of_another_length_compiles_nothing(rig, photographs, tmp_path, mode):
    """Neither the last batch of a scan nor a shorter scan has shapes of its own."""
    choice = mode.get("choice", "strongest")

    def points(images, name):
        (tmp_path / name).mkdir()
        if "exposures" in mode:
            # Of each two the first has half of the light.
            images = np.stack([images[i // 2 * 2] // (2 - i % 2) for i in range(len(images))])
        scan = scan_of(tmp_path / name, images, ".npy")
        if "exposures" in mode:
            steps = tuple(1000 * (i // 2) for i in range(len(images)))
            scan = replace(
                scan, axes={"stage": steps}, exposures_s=tuple((0.01, 0.02)[i % 2] for i in range(len(images)))
            )
        return reconstruct(rig, scan, detector="gravity", choice=choice)

    many = np.concatenate([photographs] * 6)[: 2 * FRAMES_AT_ONCE + 4]
    first = points(many, "long")
    before = compiled_sizes()
    second = points(many[: len(photographs) + 1], "short")
    assert compiled_sizes() == before
    inner = len(second.steps) - HALO
    np.testing.assert_array_equal(second.points[:inner], first.points[:inner])


def compiled_sizes() -> list[int]:
    """For how many shapes each function that sees whole frames has been compiled."""
    return [each.jitted._cache_size() for each in (coarse_peaks, choose_peaks, candidates, gather_pixels)]


def test_exposures_that_are_not_listed_are_pointed_out(rig, photographs, tmp_path):
    times = np.where(np.arange(COUNT) % 2, 0.5, 1.0)
    exposed = np.rint(photographs * times[:, None, None]).astype(np.uint8)
    scan = scan_of(tmp_path, exposed, ".png")
    scanner = Scanner(rig, "gravity")
    assert sum(image.valid.sum() for image in scanner.scan(scan))
    (note,) = scanner.notes
    assert note.startswith("the exposure changes between neighbouring frames 6 times")
    assert sum(image.valid.sum() for image in scanner.scan(replace(scan, exposures_s=tuple(times))))
    assert scanner.notes == []


@pytest.mark.parametrize("background", ["one", "dark", "many"])
def test_one_background_for_an_object_that_moves_is_pointed_out(rig, photographs, tmp_path, background):
    """Of a trial's turn the points were 1.5 mm off with one photograph for all steps, 0.4 mm without any."""
    folders = tmp_path / "lit", tmp_path / "dark"
    for folder in folders:
        folder.mkdir()
    off = 3 + np.random.default_rng(2).standard_normal(photographs.shape)
    off[:, 20, 30] = 90.0
    if background != "dark":
        off[:, 30:60, 40:80] += 8.0
    dark = scan_of(folders[1], np.rint(off).clip(0, 255).astype(np.uint8), ".png").frames
    scan = scan_of(folders[0], photographs, ".png", backgrounds=dark if background == "many" else dark[:1])
    for moves in (True, False):
        scanner = Scanner(rig, "gravity")
        list(scanner.scan(scan if moves else replace(scan, axes={"stage": (0,) * COUNT})))
        said = [note for note in scanner.notes if "is subtracted from all frames" in note]
        assert len(said) == (moves and background == "one")
