"""Fetching from a hub that is made up: pinned revision, digest, disk, and no network."""

import hashlib
import sys
import types

import pytest

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.errors import UserError
from gscomplete.priors.mvdream import store, weights
from gscomplete.priors.mvdream.store import MVDREAM, fetch_mvdream, find_mvdream
from gscomplete.priors.mvdream.weights import open_weights
from tests.builders.tiny_mvdream import TINY, write_original


class Hub(types.ModuleType):
    """Serves one file; knows what it would serve."""

    def __init__(self, content: bytes) -> None:
        super().__init__("huggingface_hub")
        self.content = self.served = content
        self.calls: list[tuple] = []

    def HfApi(self):
        return self

    def get_paths_info(self, repository, names, revision):
        self.calls.append((repository, tuple(names), revision))
        lfs = types.SimpleNamespace(
            size=len(self.content), sha256=hashlib.sha256(self.content).hexdigest()
        )
        return [types.SimpleNamespace(lfs=lfs)]

    def hf_hub_download(self, repository, filename, revision, local_dir):
        self.calls.append((repository, filename, revision))
        local_dir.mkdir(parents=True)
        (local_dir / filename).write_bytes(self.served)
        return str(local_dir / filename)


@pytest.fixture
def hub(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "PUBLISHED", TINY)
    made = Hub(write_original(tmp_path).read_bytes())
    monkeypatch.setitem(sys.modules, "huggingface_hub", made)
    return made


def test_fetches_the_pinned_revision_once(hub, tmp_path):
    folder = tmp_path / "mvdream"
    path = fetch_mvdream(folder)
    assert path == find_mvdream(folder)
    assert open_weights(path).config == TINY
    assert {call[0] for call in hub.calls} == {MVDREAM.repository}
    assert {call[2] for call in hub.calls} == {MVDREAM.revision}
    assert len(MVDREAM.revision) == 40, "a commit, not a branch that may move"
    assert [p.name for p in folder.iterdir()] == [MVDREAM.filename]
    assert fetch_mvdream(folder) == path
    assert len(hub.calls) == 3, "the second time only the digest is asked for"


def test_a_damaged_download_is_removed(hub, tmp_path):
    hub.served = hub.content[:-1] + b"x"
    with pytest.raises(UserError, match="SHA-256"):
        fetch_mvdream(tmp_path / "mvdream")
    assert not (tmp_path / "mvdream" / MVDREAM.filename).exists()


def test_another_file_than_mvdream_is_refused(hub, tmp_path):
    hub.content = hub.served = b"something else"
    with pytest.raises(UserError, match="expected PyTorch's file of named tensors"):
        fetch_mvdream(tmp_path / "mvdream")
    assert not (tmp_path / "mvdream" / MVDREAM.filename).exists()


def test_too_little_disk_is_found_out_before(hub, tmp_path, monkeypatch):
    monkeypatch.setattr(store.shutil, "disk_usage", lambda path: types.SimpleNamespace(free=1000))
    with pytest.raises(UserError, match="free space"):
        fetch_mvdream(tmp_path / "mvdream")
    assert all(isinstance(call[1], tuple) for call in hub.calls), "nothing was downloaded"


def test_without_a_network_the_message_says_what_to_do(hub, tmp_path, monkeypatch):
    def fail(*arguments, **more):
        raise ConnectionError("no route\nmore")

    monkeypatch.setattr(hub, "get_paths_info", fail)
    with pytest.raises(UserError, match=r"no route\); fetch sd-v2\.1-base-4view\.pt"):
        fetch_mvdream(tmp_path / "mvdream")
