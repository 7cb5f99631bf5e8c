import torch

from gscomplete.util.versions import differences_note, made_with


def test_what_has_not_changed_is_not_told():
    assert differences_note(made_with()) == ()
    for damaged in (None, [], "x", {}):
        assert differences_note(damaged) == ()


def test_what_bytes_depend_on_is_told():
    (note,) = differences_note(made_with() | {"torch_threads": 77, "torch": "1.0"})
    assert f"torch 1.0 (now {torch.__version__})" in note
    assert f"torch_threads 77 (now {torch.get_num_threads()})" in note
    # Numba's kernels give each thread rows of its own: their sums do not change
    assert differences_note(made_with() | {"numba_threads": 77}) == ()
