from pathlib import Path
from types import SimpleNamespace

import pytest

from gscomplete.cli.complete_options import CompleteOptions
from gscomplete.cli.request import request_of
from gscomplete.completion import run_folder
from gscomplete.errors import UserError
from gscomplete.priors import load_prior
from gscomplete.shape.mirror_plane import HalfCut, MirrorPlane
from gscomplete.splats import validation, write_splats
from tests.builders.commands import SAMPLE, run_here
from tests.builders.folders import write_object_folder
from tests.builders.objects import ball, random_splats


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"prompt": "\udcff cup"}, r"--prompt: expected UTF-8 text, found '\\udcff cup'"),
        ({"prompt": " "}, "--prompt: expected a name"),
        ({"prompt": "a cup", "negative_prompt": "\udcff"}, "--negative-prompt: expected UTF-8"),
    ],
)
def test_words_that_no_prior_can_read_are_refused(words, message):
    options = CompleteOptions(partial=Path("half.ply"), **words)
    with pytest.raises(UserError, match=message):
        request_of(options, SimpleNamespace(name="known"))


def test_resuming_is_told_of_once_there_is_a_run_to_resume(monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    words = "complete", SAMPLE, "--prompt", "a mug", "--out", tmp_path / "run"
    monkeypatch.setattr(run_folder, "prepare", interrupted)
    assert "interrupted; the same command starts again\n" in run_here(*words).stderr
    begun = SimpleNamespace(notes=(), steps=SimpleNamespace(step_number=0, finished=True))
    monkeypatch.setattr(run_folder, "prepare", lambda *_: begun)
    monkeypatch.setattr(run_folder, "execute", interrupted)
    told = run_here(*words)
    assert told.returncode == 130
    assert "interrupted; --resume continues from the last checkpoint\n" in told.stderr
    monkeypatch.setattr(validation, "validate_file", interrupted)
    assert "interrupted; the same command starts again\n" in run_here("validate", SAMPLE).stderr


@pytest.mark.parametrize("command", ["complete", "batch"])
def test_filling_gaps_asks_for_no_prior(tmp_path, command):
    """Before the prior is looked for: its weights are not there."""
    words = (command, SAMPLE, "--fill", "--prior", "mvdream", "--out", tmp_path / "run")
    told = run_here(*words)
    assert told.returncode == 2
    assert "--fill: closes gaps without a prior; expected no --prior\n" in told.stderr


@pytest.mark.parametrize("mirror", ["none", "30,0.1", "cut", "cut:30"])
def test_a_plane_is_refused_where_the_prior_cannot_guess_the_complete_object(mirror):
    """``reconstruct`` starts from a guess, but only if the prior has one."""
    options = CompleteOptions(
        partial=Path("half.ply"), prompt="a mug", preset="reconstruct", mirror=mirror
    )
    with pytest.raises(UserError, match="found preset reconstruct with prior known"):
        request_of(options, SimpleNamespace(name="known"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("none", "none"),
        ("cut", HalfCut()),
        ("cut:-30", HalfCut(-30.0)),
        ("30,0.1", MirrorPlane(30.0, 0.1)),
    ],
)
def test_what_to_mirror_through_is_read(text, expected):
    prior = load_prior("embedded")
    options = CompleteOptions(partial=Path("half.ply"), prompt="a mug", mirror=text)
    settings = request_of(options, prior).completion.settings
    assert settings.mirror == expected
    assert text == "30,0.1" or str(settings.mirror) == text


def test_a_center_that_the_object_folder_knows_alone_is_used(tmp_path):
    changes = {"frame_origin": "guess", "frame_given": ("center",)}
    folder = write_object_folder(tmp_path / "mug", random_splats(5), **changes)
    request = request_of(CompleteOptions(partial=folder), load_prior("embedded"))
    assert request.completion.framing.center_file == (0.1, 0.0, 0.0)
    assert request.completion.framing.size_file is None
    assert (request.sources["center"], request.sources["size"]) == ("object.json", "guess")


@pytest.mark.parametrize("text", ["cut:", "cut:a", "cut:1,2", "cut:inf", "half", "1", ""])
def test_what_to_mirror_through_is_refused_in_another_form(text):
    options = CompleteOptions(partial=Path("half.ply"), prompt="a mug", mirror=text)
    with pytest.raises(UserError, match="--mirror: expected guess, none, cut"):
        request_of(options, load_prior("embedded"))


@pytest.mark.parametrize(("text", "field"), [("cut:1e300", "cut"), ("1e300,0", "azimuth_deg")])
def test_what_to_mirror_through_is_refused_beyond_its_range(text, field):
    options = CompleteOptions(partial=Path("half.ply"), prompt="a mug", mirror=text)
    with pytest.raises(UserError, match=f"mirror: {field}: expected an azimuth of .* found 1e"):
        request_of(options, load_prior("embedded"))


def test_one_half_and_a_prompt_cannot_both_decide():
    options = CompleteOptions(
        partial=Path("half.ply"), prompt="a mug", mirror="cut", prompt_decides=True
    )
    with pytest.raises(UserError, match="expected no --mirror cut"):
        request_of(options, load_prior("embedded"))


def request_with(**changes):
    options = CompleteOptions(partial=Path("half.ply"), prompt="a mug", **changes)
    return request_of(options, SimpleNamespace(name="mvdream"))


@pytest.mark.parametrize("steps", [6000, 600, 12_000])
def test_what_is_counted_in_steps_stretches_with_their_number(steps):
    whole = request_with().completion.settings
    chosen = request_with(steps=steps).completion.settings
    assert chosen.steps == steps
    share = steps / whole.steps
    assert chosen.warmup_steps == round(share * whole.warmup_steps)
    assert chosen.densify.every == round(share * whole.densify.every)
    within = range(1, int(chosen.densify.until * steps))
    assert sum(step % chosen.densify.every == 0 for step in within) == sum(
        step % whole.densify.every == 0 for step in range(1, int(whole.densify.until * whole.steps))
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"known_shapes": False}, "expected no --no-known-shapes"),
        ({"alternatives": 3}, "expected no --alternatives"),
        ({"fill": True}, "expected no --prompt-decides"),
        ({}, "expected a run that starts from a guess"),  # MVDream guesses no complete objects
    ],
)
def test_the_prompt_decides_by_a_guess_with_known_shapes(changes, message):
    with pytest.raises(UserError, match=message):
        request_with(prompt_decides=True, **changes)


@pytest.mark.parametrize(
    ("subset", "edge_colors", "expected"),
    [
        ("lidar", "auto", True),
        ("singleview", "auto", True),
        ("mesh", "auto", False),
        ("multiview", "auto", False),
        (None, "auto", False),
        ("lidar", "trust", False),
        (None, "ignore", True),
    ],
)
def test_edge_colours_are_ignored_where_a_depth_camera_mixed_them(
    tmp_path, subset, edge_colors, expected
):
    partial = Path("half.ply")
    if subset is not None:
        partial = write_object_folder(tmp_path / "mug", ball(50), subset=subset)
    options = CompleteOptions(partial=partial, prompt="a mug", edge_colors=edge_colors)
    settings = request_of(options, load_prior("embedded")).completion.settings
    assert settings.mixed_edge_colors is expected


@pytest.mark.parametrize(
    ("subset", "is_known", "captured", "expected"),
    [
        ("multiview", False, "auto", True),
        ("multiview", True, "auto", False),  # P was cut from it
        ("lidar", False, "auto", False),
        (None, False, "auto", False),
        ("multiview", False, "no", False),
        (None, False, "yes", True),
    ],
)
def test_what_was_trained_from_photos_and_not_cut_is_captured(
    tmp_path, subset, is_known, captured, expected
):
    partial = Path("half.ply")
    if subset is not None:
        whole = ball(50) if is_known else None
        partial = write_object_folder(tmp_path / "mug", ball(50), whole, subset=subset)
    options = CompleteOptions(partial=partial, prompt="a mug", captured=captured)
    settings = request_of(options, load_prior("embedded")).completion.settings
    assert settings.captured is expected


def test_whether_p_was_captured_is_no_matter_without_a_guess():
    with pytest.raises(UserError, match="--captured: expected a run that starts from a guess"):
        request_with(captured="yes")
    with pytest.raises(UserError, match="expected no --captured"):
        request_with(captured="yes", fill=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fill": True}, "expected no --edge-colors"),
        ({}, "--edge-colors: expected a run that starts from a guess"),  # MVDream guesses nothing
    ],
)
def test_edge_colours_are_no_matter_without_a_guess(changes, message):
    with pytest.raises(UserError, match=message):
        request_with(edge_colors="ignore", **changes)


@pytest.mark.parametrize(
    ("preset", "leaves_out", "expected"),
    [("default", True, True), ("default", False, False), ("paper", True, False)],
)
def test_strays_are_left_out_unless_all_of_p_is_to_be_heeded(preset, leaves_out, expected):
    options = CompleteOptions(
        partial=Path("half.ply"), prompt="a mug", preset=preset, leave_out_strays=leaves_out
    )
    settings = request_of(options, load_prior("embedded")).completion.settings
    assert settings.leave_out_strays is expected


def test_a_replaced_part_is_doubted(tmp_path):
    folder = write_object_folder(tmp_path / "mug", random_splats(5))
    prior = load_prior("embedded")
    assert request_of(CompleteOptions(partial=folder), prior).notes == ()
    write_splats(folder / "partial.ply", random_splats(6))
    (note,) = request_of(CompleteOptions(partial=folder), prior).notes
    assert note.startswith(f"doubtful: {folder / 'partial.ply'} is not the file that object.json")
