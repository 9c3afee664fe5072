import errno
import os
import stat

import pytest

from jaxscan.atomic import replacing
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
    for path, says in ((tmp_path / "no" / "rig.json", "create it first"), (tmp_path, "is a folder")):
        with pytest.raises(InputError, match=says), replacing(path):
            pass


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_closed_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="may write"), replacing(tmp_path / "rig.json"):
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
