"""Digests of files of any size, and of files that are none."""

import hashlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.util.digests import sha256_of


@given(st.binary(max_size=200))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_digest_is_the_one_of_all_bytes(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert sha256_of(path) == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize(
    ("content", "digest"),
    [
        (b"", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"),
        (b"abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"),
    ],
)
def test_digests_of_the_standard(tmp_path, content, digest):
    """FIPS 180-4's own examples."""
    path = tmp_path / "file"
    path.write_bytes(content)
    assert sha256_of(path) == digest


@pytest.mark.parametrize("extra", [-1, 0, 1])
def test_files_larger_than_a_buffer_are_read_to_their_end(tmp_path, extra):
    """The library reads 2^18 bytes at a time."""
    content = bytes(range(256)) * 3 * 1024 + b"x" * (2 + extra)
    path = tmp_path / "large"
    path.write_bytes(content)
    whole = hashlib.sha256()
    for start in range(0, len(content), 1000):
        whole.update(content[start : start + 1000])
    assert sha256_of(path) == whole.hexdigest()


def test_the_name_of_a_file_does_not_count_and_line_ends_do(tmp_path):
    for name, content in (("a", b"one\n"), ("b", b"one\n"), ("c", b"one\r\n")):
        (tmp_path / name).write_bytes(content)
    a, b, c = (sha256_of(tmp_path / name) for name in "abc")
    assert a == b != c


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(UserError, match=r"gone: cannot read it \(No such file"):
        sha256_of(tmp_path / "gone")
    with pytest.raises(UserError, match="cannot read it"):
        sha256_of(tmp_path)
