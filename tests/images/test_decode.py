import os
import subprocess
import sys

import cv2
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images import image_size, read_image, read_video, to_grey, write_image


def ramp(shape, dtype):
    return (np.arange(np.prod(shape)).reshape(shape) * (7 if dtype == np.uint8 else 701)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
@pytest.mark.parametrize("ending", [".png", ".tif"])
def test_what_is_written_is_read(tmp_path, dtype, shape, ending):
    path, image = tmp_path / f"image{ending}", ramp(shape, dtype)
    write_image(path, image)
    read = read_image(path)
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, image)
    assert image_size(path) == (7, 5)


def test_red_is_first_and_alpha_is_dropped(tmp_path):
    path = tmp_path / "red.png"
    cv2.imwrite(str(path), np.full((4, 5, 4), (0, 10, 200, 77), np.uint8))
    np.testing.assert_array_equal(read_image(path), np.full((4, 5, 3), (200, 10, 0)))
    cv2.imwrite(str(tmp_path / "red.bmp"), np.full((4, 5, 3), (0, 10, 200), np.uint8))
    np.testing.assert_array_equal(read_image(tmp_path / "red.bmp"), np.full((4, 5, 3), (200, 10, 0)))


@pytest.mark.parametrize("ending", [".png", ".jpg"])
@pytest.mark.parametrize("grey", [True, False])
def test_a_cut_off_image_is_refused_and_bytes_after_its_end_are_not(tmp_path, ending, grey):
    noise = np.random.default_rng(0).integers(0, 255, (40, 50) if grey else (40, 50, 3), np.uint8)
    whole = tmp_path / f"whole{ending}"
    write_image(whole, noise)
    data = whole.read_bytes()
    cut = tmp_path / f"cut{ending}"
    for length in (len(data) // 2, len(data) - 2):
        cut.write_bytes(data[:length])
        with pytest.raises(InputError, match="cut off"):
            read_image(cut)
        assert image_size(cut) == (50, 40)
        with pytest.raises(InputError, match="cut off"):
            image_size(cut, to_its_end=True)
    cut.write_bytes(data + b"a preview")
    np.testing.assert_array_equal(read_image(cut), read_image(whole))


def test_a_thumbnail_does_not_end_a_cut_off_jpeg(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    write_image(tmp_path / "photo.jpg", noise)
    data = (tmp_path / "photo.jpg").read_bytes()
    thumbnail = b"\xff\xd8 a picture of its own \xff\xd9"
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    data = data[:2] + segment + data[2:]
    path = tmp_path / "cut.jpg"
    path.write_bytes(data)
    assert image_size(path) == (80, 60)
    assert read_image(path).shape == (60, 80, 3)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cut off"):
        read_image(path)


def test_what_is_no_image_is_named_and_nothing_else_is_printed(tmp_path, capfd):
    text = tmp_path / "notes.png"
    for content in (b"", b"not an image", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"):
        text.write_bytes(content)
        for reader in (read_image, image_size):
            with pytest.raises(InputError, match=r"notes\.png"):
                reader(text)
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "missing.png")
    with pytest.raises(InputError, match="folder"):
        image_size(tmp_path)
    cv2.imwrite(str(tmp_path / "depth.tif"), np.zeros((4, 4), np.float32))
    with pytest.raises(InputError, match="float32"):
        read_image(tmp_path / "depth.tif")
    assert capfd.readouterr().err == ""


def test_what_is_no_video_is_named(tmp_path):
    text = tmp_path / "notes.mp4"
    text.write_bytes(b"\xff\xd8\xff")
    with pytest.raises(InputError, match=r"notes\.mp4.*video"):
        read_video(text)
    with pytest.raises(InputError, match="no such file"):
        read_video(tmp_path / "missing.mp4")


@pytest.mark.parametrize(
    "opened",
    [
        "from jaxscan.images.decode import read_video as opened",
        "from hardware.cameras.opencv import OpenCvCamera; opened = lambda path: OpenCvCamera(path).open()",
    ],
)
def test_of_what_is_no_video_ffmpeg_prints_nothing(tmp_path, opened):
    """In a process of its own, for FFmpeg asks how loud it may be once, when the first video is opened or written."""
    (tmp_path / "notes.png").write_bytes(b"\xff\xd8\xff")
    env = {name: value for name, value in os.environ.items() if name != "OPENCV_FFMPEG_LOGLEVEL"}
    script = f"{opened}\ntry:\n    opened('notes.png')\nexcept Exception as error:\n    print(error)"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("begin", ["ffconcat version 1.0\nfile scan.avi\n", "#EXTM3U\n#EXTINF:10,\nscan.avi\n"])
def test_a_playlist_is_no_video(tmp_path, begin, capfd):
    """FFmpeg opened what it named: another file, or an address."""
    writer = cv2.VideoWriter(str(tmp_path / "scan.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    (tmp_path / "list.mp4").write_text(begin)
    with pytest.raises(InputError, match=r"list\.mp4: is not a video .* but text"):
        read_video(tmp_path / "list.mp4")
    assert len(list(read_video(tmp_path / "scan.avi"))) == 1
    assert capfd.readouterr().err == ""


def test_writing_to_a_format_that_cannot_hold_it(tmp_path):
    with pytest.raises(InputError, match="16 bits"):
        write_image(tmp_path / "deep.jpg", ramp((4, 5), np.uint16))
    with pytest.raises(InputError, match="xyz"):
        write_image(tmp_path / "image.xyz", ramp((4, 5), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_video_is_read_frame_by_frame(tmp_path):
    path = tmp_path / "scan.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for level in (40, 120, 200):
        writer.write(np.full((48, 64, 3), (0, 0, level), np.uint8))
    writer.release()
    frames = list(read_video(path))
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 3
    np.testing.assert_allclose([frame[..., 0].mean() for frame in frames], [40, 120, 200], atol=6)
    assert max(frame[..., 2].max() for frame in frames) < 20


def test_a_video_that_ends_early_is_said(tmp_path):
    path = tmp_path / "cut.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for frame in np.random.default_rng(0).integers(0, 255, (20, 48, 64, 3), np.uint8):
        writer.write(frame)
    writer.release()
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 5])
    with pytest.warns(UserWarning, match=r"cut\.avi: ends after \d+ of 20 frames"):
        assert len(list(read_video(path))) < 20


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_keeps_the_depth(dtype):
    image = np.zeros((3, 4, 3), dtype)
    image[..., 1] = 200
    grey = to_grey(image)
    assert grey.dtype == dtype
    np.testing.assert_allclose(grey, 0.587 * 200, atol=1)
    assert to_grey(grey) is grey


def test_real_photographs_match_opencv(data):
    for name in ("ciclop-bust/laser.png", "opencv-left/left01.jpg", "stage-boards/Snap_001.jpg"):
        expected = cv2.imread(str(data / name), cv2.IMREAD_UNCHANGED)
        expected = expected if expected.ndim == 2 else expected[..., 2::-1]
        np.testing.assert_array_equal(read_image(data / name), expected)
        assert image_size(data / name) == expected.shape[1::-1]


@pytest.mark.parametrize("look", [read_image, image_size])
def test_an_empty_file(tmp_path, look):
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(InputError, match=r"photo\.jpg: the file is empty"):
        look(tmp_path / "photo.jpg")
