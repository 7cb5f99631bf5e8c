import torch

from gscomplete.util.versions import differences_note, made_with


def test_what_has_not_changed_is_not_told():
    assert differences_note(made_with()) == ()
    for damaged in (None, [], "x", {}):
        assert differences_note(damaged) == ()


def test_what_bytes_depend_on_is_told():
    (note,) = differences_note(made_with() | {"torch": "1.0", "processor": "arm64 DEFAULT"})
    assert f"torch 1.0 (now {torch.__version__})" in note
    assert "processor arm64 DEFAULT (now " in note


def test_threads_are_kept_but_bytes_do_not_depend_on_them():
    assert {"torch_threads", "numba_threads"} <= set(made_with())
    assert differences_note(made_with() | {"numba_threads": 77, "torch_threads": 77}) == ()
