import errno
import os
import stat

import pytest

from jaxscan.atomic import check_writable, replacing, replacing_folders
from jaxscan.errors import InputError


def test_the_file_is_whole_and_alone(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text("old")
    with replacing(path, "w") as file:
        file.write("ω · X = 1\n")
        assert path.read_text() == "old"
    assert path.read_bytes() == "ω · X = 1\n".encode()
    assert os.listdir(tmp_path) == ["rig.json"]


def test_an_error_leaves_what_was_there(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_bytes(b"old")

    def fail():
        with replacing(path) as file:
            file.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["cloud.ply"]


def test_permissions_are_those_of_a_plain_open(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    with replacing(tmp_path / "ours") as file:
        file.write(b"")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "ours")]
    assert modes[0] == modes[1]


def test_a_missing_folder_and_a_folder_in_the_way_are_named(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    for path, says in (
        (tmp_path / "no" / "rig.json", "create it first"),
        (tmp_path, "is a folder"),
        (tmp_path / "plain" / "rig.json", "plain is no folder: name a file in a folder"),
    ):
        with pytest.raises(InputError, match=says):
            check_writable(path)
        with pytest.raises(InputError, match=says), replacing(path):
            pass


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="no /proc here")
def test_a_place_that_takes_no_file_is_refused_before_any_work_even_for_root():
    """Permissions there say yes to root."""
    for path in ("/proc/rig.json", "/proc/self/rig.json"):
        with pytest.raises(InputError, match=rf"{path}: cannot be written \(.*choose another"):
            check_writable(path)


def test_a_full_disk_is_met_before_any_work(tmp_path, monkeypatch):
    """The first file on it that finds no room, and so for a disk that is mounted read-only."""
    for number, says in ((errno.ENOSPC, "make room"), (errno.EROFS, "may write")):

        def refuse(*_, number=number, **__):
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as patch:
            patch.setattr("pathlib.Path.open", refuse)
            with pytest.raises(InputError, match=says):
                check_writable(tmp_path / "rig.json")


def test_trying_leaves_no_trace_and_touches_nothing(tmp_path):
    path = tmp_path / "rig.json"
    check_writable(path)
    assert os.listdir(tmp_path) == []
    path.write_text("old")
    before = path.stat()
    check_writable(path)
    after = path.stat()
    assert (after.st_mtime_ns, after.st_ino, path.read_text()) == (before.st_mtime_ns, before.st_ino, "old")
    assert os.listdir(tmp_path) == ["rig.json"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root choose another anywhere")
def test_a_closed_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="choose another"), replacing(tmp_path / "rig.json"):
        pass


def test_a_full_disk_is_an_input_error_and_a_foreign_error_is_not(tmp_path):
    def meet(error):
        with replacing(tmp_path / "rig.json"):
            raise error

    with pytest.raises(InputError, match="make room"):
        meet(OSError(errno.ENOSPC, "No space left on device"))
    with pytest.raises(TimeoutError):
        meet(TimeoutError(errno.ETIMEDOUT, "scanner"))
    assert os.listdir(tmp_path) == []


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "rig.json").write_text("old")
    (tmp_path / "link.json").symlink_to("elsewhere/rig.json")
    with replacing(tmp_path / "link.json", "w") as file:
        file.write("new")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "elsewhere" / "rig.json").read_text() == "new"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_plain_file_is_left_alone(tmp_path):
    """A device too would otherwise be renamed over, by a user who may."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for name in ("pipe", "loop"):
        with pytest.raises(InputError, match=f"{name}: .*name a plain file"):
            check_writable(tmp_path / name)
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_name_that_is_too_long_is_refused_before_any_work(tmp_path):
    with pytest.raises(InputError, match="shorter name"):
        check_writable(tmp_path / ("x" * 250))


def test_folders_change_together_or_not_at_all(tmp_path):
    out = tmp_path / "world"

    def write(text, error=None):
        with replacing_folders(out) as folder:
            for name in ("scan", "truth"):
                (folder / name).mkdir()
                (folder / name / "a").write_text(text)
            if error:
                raise error

    with pytest.raises(KeyboardInterrupt):
        write("half", KeyboardInterrupt())
    assert not out.exists()
    write("first")
    (out / "rig.json").write_text("mine")
    with pytest.raises(ZeroDivisionError):
        write("half", ZeroDivisionError())
    assert (out / "scan" / "a").read_text() == "first"
    write("second")
    assert (out / "truth" / "a").read_text() == "second"
    assert sorted(os.listdir(out)) == ["rig.json", "scan", "truth"]
