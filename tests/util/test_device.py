"""Which device is chosen, and what is told of it."""

import pytest
import torch

from gscomplete.util.device import _tell_of_unused_cuda, choose_device


@pytest.mark.parametrize("cuda", [None, "12.8"])
def test_a_build_for_gpus_without_one_is_told_once(monkeypatch, caplog, cuda):
    _tell_of_unused_cuda.cache_clear()
    monkeypatch.setattr(torch.version, "cuda", cuda)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for _ in range(2):
        assert choose_device("auto") == torch.device("cpu")
    assert choose_device("cpu") == torch.device("cpu")
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == (cuda is not None)
    assert all("built for CUDA 12.8 but finds no GPU" in text for text in told)
