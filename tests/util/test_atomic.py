"""Atomic writes: all or nothing, and clear errors."""

import errno
import os

import pytest

from gscomplete.errors import UserError
from gscomplete.util.atomic import atomic_path


def write_half_and_stop(path):
    path.write_bytes(b"half")
    raise KeyboardInterrupt


def test_success_replaces_and_leaves_no_temporary(tmp_path):
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")
    target.chmod(0o640)
    with atomic_path(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".bin"
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert target.stat().st_mode & 0o777 == 0o640
    assert os.listdir(tmp_path) == ["a.bin"]


def test_failure_keeps_the_old_file(tmp_path):
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), atomic_path(target) as temporary:
        write_half_and_stop(temporary)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_link_stays_a_link(tmp_path):
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_bytes(b"old")
    link.symlink_to(real)
    with atomic_path(link) as temporary:
        temporary.write_bytes(b"new")
    assert link.is_symlink()
    assert real.read_bytes() == b"new"


def test_a_link_that_leads_back_to_itself_is_told(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with (
        pytest.raises(UserError, match="cannot write: it is a link that leads back to itself"),
        atomic_path(tmp_path / "a"),
    ):
        pass
    assert (tmp_path / "a").is_symlink()


@pytest.mark.parametrize("name", ["missing/a.ply", "file/a.ply", "folder", "x" * 300])
def test_unwritable_destination_is_a_user_error(tmp_path, name):
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="cannot write"), atomic_path(tmp_path / name) as temporary:
        temporary.write_bytes(b"x")


def test_full_disk_is_a_user_error(tmp_path):
    with pytest.raises(UserError, match="disk is full"), atomic_path(tmp_path / "a.ply"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert os.listdir(tmp_path) == []


def test_other_errors_pass_through(tmp_path):
    with pytest.raises(OSError, match="odd"), atomic_path(tmp_path / "a.ply"):
        raise OSError(errno.EBADF, "odd")
