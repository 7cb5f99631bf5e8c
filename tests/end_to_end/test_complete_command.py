"""``gscomplete complete`` as a user runs it: on real files, killed, and asked for nonsense.

Most runs are in the process of the tests, which has loaded PyTorch; what is about processes has its
own.
"""

import dataclasses
import json
import os
import signal
import time
from pathlib import Path

import pytest
import torch

from gscomplete.splats import Splats, read_splats, write_splats
from tests.builders.commands import PATIENCE_S, SAMPLE, Told, run_alone, run_here, start_alone
from tests.builders.folders import write_object_folder
from tests.builders.objects import ball, half
from tests.builders.ply_files import make_ply, random_table

STEPS = 8
QUICK = ("--preset", "reconstruct", "--steps", STEPS, "--mirror", "none")
"""One answer of the shape network in place of nine, and a few steps."""
WITHOUT_STEPS = ("--preset", "fast", "--mirror", "none")


def arguments_of(path: Path, out: Path, *more: object) -> tuple[object, ...]:
    return ("complete", path, "--prompt", "a red mug", "--out", out, *QUICK, *more)


def complete(path: Path, out: Path, *more: object) -> Told:
    return run_here(*arguments_of(path, out, *more))


def shell(count: int = 800, offset: float = 0.0, size: float = 1.0) -> Splats:
    """Half a ball of a size somewhere in the file."""
    part = half(ball(2 * count, 0.5))
    return dataclasses.replace(part, means=size * part.means + offset, scales=size * part.scales)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("run") / "mug"
    alone = out.with_name("new.ply")
    result = run_alone(*arguments_of(SAMPLE, out, "--new-only", alone, "--profile"))
    assert result.returncode == 0, result.stderr
    assert f"the new splats alone: {alone}" in result.stdout
    profile = json.loads((out / "run.json").read_text())["profile"]
    assert {"load", "read", "frame", "render", "prior", "write", "metrics"} <= profile.keys()
    assert all(f"\n{name} " in result.stdout for name in profile)
    return out


def test_run_folder_is_complete_and_partial_is_kept_byte_for_byte(finished):
    names = {path.name for path in finished.iterdir()}
    assert {"completed.ply", "run.json", "preview.png", "turntable.webp", "log.jsonl"} <= names
    source, completed = read_splats(SAMPLE), read_splats(finished / "completed.ply")
    records = bytes(source.payload.records)
    assert bytes(completed.payload.records[: len(records)]) == records
    content = json.loads((finished / "run.json").read_text())
    new = content["result"]["new_splats"]
    assert completed.n_rows == source.n_rows + new
    assert f"gscomplete new_splats {new}" in completed.comments
    assert content["status"] == "finished"
    assert content["result"]["metrics"]["all_views"]["color"] >= 0
    assert len((finished / "log.jsonl").read_text().splitlines()) == STEPS
    assert run_here("validate", finished / "completed.ply").returncode == 0


def test_new_splats_can_be_had_alone(finished, tmp_path):
    alone = finished.with_name("new.ply")
    new, together = read_splats(alone), read_splats(finished / "completed.ply")
    assert len(new.splats) == len(together.splats) - read_splats(SAMPLE).n_rows > 0
    for (name, own), (_, other) in zip(new.splats.fields(), together.splats.fields(), strict=True):
        torch.testing.assert_close(own, other[-len(new.splats) :], msg=name)
    result = complete(SAMPLE, tmp_path / "again", "--new-only", alone)
    assert (result.returncode, (tmp_path / "again").exists()) == (2, False)
    assert "it exists" in result.stderr


def test_same_seed_same_bytes(finished, tmp_path):
    assert complete(SAMPLE, tmp_path / "again").returncode == 0
    again = (tmp_path / "again/completed.ply").read_bytes()
    assert again == (finished / "completed.ply").read_bytes()


def interrupted(out, number: int, *more: object) -> tuple[int, str]:
    """Start the sample's run, or go on with it, and send a signal once it has a new checkpoint."""
    checkpoint = out / "checkpoints/latest.safetensors"
    before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
    child = start_alone(*arguments_of(SAMPLE, out, "--checkpoint-every", "2", *more))
    deadline = time.monotonic() + PATIENCE_S
    while child.poll() is None and time.monotonic() < deadline:
        if checkpoint.exists() and checkpoint.stat().st_mtime_ns > before:
            break
        time.sleep(0.02)
    os.kill(child.pid, number)
    _, told = child.communicate()
    assert not (out / "completed.ply").exists()
    return child.returncode, told


def test_killed_and_resumed_run_gives_the_same_bytes(finished, tmp_path):
    out = tmp_path / "killed"
    interrupted(out, signal.SIGKILL)
    code, told = interrupted(out, signal.SIGTERM, "--resume")
    assert code == 143
    assert told.endswith("stopped by SIGTERM; --resume continues from the last checkpoint\n")
    result = complete(SAMPLE, out, "--checkpoint-every", "2", "--resume")
    assert result.returncode == 0, result.stderr
    assert "resuming at step" in result.stdout
    assert (out / "completed.ply").read_bytes() == (finished / "completed.ply").read_bytes()
    lines = [json.loads(line)["step"] for line in (out / "log.jsonl").read_text().splitlines()]
    assert lines == list(range(STEPS))


def test_resume_with_other_options_is_refused(finished):
    result = complete(SAMPLE, finished, "--resume", "--seed", "5")
    assert result.returncode == 2
    assert "seed: the run has 0, asked for 5" in result.stderr


def test_existing_folder_is_not_touched(finished):
    before = (finished / "completed.ply").read_bytes()
    result = complete(SAMPLE, finished)
    assert result.returncode == 2
    assert "exists and is not empty" in result.stderr
    assert (finished / "completed.ply").read_bytes() == before


@pytest.mark.parametrize(("offset", "size"), [(1e4, 1.0), (0.0, 1e-6), (0.0, 1e6)])
def test_any_place_and_size(tmp_path, offset, size):
    path = tmp_path / "shell.ply"
    write_splats(path, shell(offset=offset, size=size))
    result = complete(path, tmp_path / "out", "--json", "--steps", "3")
    assert result.returncode == 0, result.stderr
    content = json.loads(result.stdout)
    # The unit is right; how far the box of half a ball grows is the guess's affair.
    assert content["identity"]["frame"]["size_file"] == pytest.approx(size, rel=0.6)
    completed = read_splats(tmp_path / "out/completed.ply").splats
    assert (completed.means - offset).abs().max() < 2 * size


def test_bad_files_are_named_without_a_traceback(tmp_path):
    good = tmp_path / "good.ply"
    write_splats(good, shell())
    data = good.read_bytes()
    nan_bytes = bytearray(data)
    head = data.index(b"end_header\n") + 11
    nan_bytes[head:] = b"\xff" * (len(data) - head)
    cases = {
        "text.ply": b"hello",
        "empty.ply": b"",
        "truncated.ply": data[: len(data) // 2],
        "nan.ply": bytes(nan_bytes),
        "mesh.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    }
    for name, content in cases.items():
        path = tmp_path / name
        path.write_bytes(content)
        result = complete(path, tmp_path / f"out_{name}")
        assert result.returncode == 2, (name, result.stderr)
        assert name in result.stderr, name
        assert "Traceback" not in result.stderr, name
        assert path.read_bytes() == content, name


def test_what_the_input_view_does_not_show_is_refused_before_the_run(tmp_path):
    hidden, seen = tmp_path / "hidden.ply", tmp_path / "seen.ply"
    part = shell()
    write_splats(hidden, dataclasses.replace(part, opacities=0 * part.opacities))
    write_splats(seen, part)
    cases = (
        (hidden, (), "input view"),
        (seen, ("--center", "9,9,9"), "expected a frame that P lies in"),
        (seen, ("--object-size", "1000"), "(file units), found 1000"),
    )
    for path, more, message in cases:
        result = complete(path, tmp_path / "out", *more)
        assert result.returncode == 2
        assert path.name in result.stderr
        assert message in result.stderr
        assert not (tmp_path / "out").exists()


def test_an_object_folder_says_what_options_leave_open(tmp_path):
    """The folder, and any file that it records, stand for the object; run.json says so."""
    folder = write_object_folder(tmp_path / "mug", shell())
    quick = ("--preset", "fast", "--json")
    plain = run_here("complete", folder, "--out", tmp_path / "a", *quick)
    assert plain.returncode == 0, plain.stderr
    content = json.loads(plain.stdout)
    identity, given = content["identity"], content["input"]
    assert identity["prompt"] == "a red mug"
    assert identity["frame"]["up"] == "Y"
    assert identity["frame"]["center_file"] == [0.1, 0.0, 0.0]  # given by hand, so known
    views = identity["views"]
    assert (views["azimuth_deg"], views["elevation_deg"]) == (30.0, 10.0)
    assert (views["azimuth_range_deg"], views["elevation_range_deg"]) == (40.0, 12.0)
    assert given["object"] == str(folder)
    assert set(given["sources"].values()) == {"object.json"}
    assert set(given["sources"]) == {"prompt", "up", "input_view", "V", "center", "size"}

    more = ("--prompt", "a jug", "--range", "20", "--up", "Z", "--object-size", "1.5")
    other = run_here("complete", folder / "preview.png", "--out", tmp_path / "b", *quick, *more)
    assert other.returncode == 0, other.stderr
    content = json.loads(other.stdout)
    assert content["identity"]["prompt"] == "a jug"
    assert content["identity"]["views"]["azimuth_range_deg"] == 20.0
    assert content["input"]["sources"] == {
        "prompt": "--prompt", "up": "--up", "input_view": "guess", "V": "--range",
        "center": "object.json", "size": "--object-size",
    }  # fmt: skip
    assert "its input view is for up axis Y, not Z" in other.stderr


def test_another_file_beside_an_object_means_itself(tmp_path):
    folder = tmp_path / "other"
    folder.mkdir()
    write_splats(folder / "partial.ply", shell())
    (folder / "object.json").write_text('{"frame": []}')  # of some other program
    refused = run_here("complete", folder / "partial.ply", "--out", tmp_path / "out")
    assert refused.returncode == 2
    assert "--prompt: expected a name of the complete object" in refused.stderr
    assert complete(tmp_path, tmp_path / "out").returncode == 2


def test_single_splat_needs_a_frame_and_then_completes(tmp_path):
    path = tmp_path / "one.ply"
    write_splats(path, shell().select(torch.tensor([0])))
    alone = complete(path, tmp_path / "a")
    assert alone.returncode == 2
    assert "--center, --object-size and --view" in alone.stderr
    framed = complete(
        path, tmp_path / "b", "--center", "0,0,0", "--object-size", "1", "--view", "0,10"
    )
    assert framed.returncode == 0, framed.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--prior", "nonsense"), "nonsense"),
        (("--view", "north"), "--view"),
        (("--view", "2000000,0"), "--view"),
        (("--object-size", "-1"), "--object-size"),
        (("--device", "tpu9"), "--device"),
        (("--steps", "-1"), "steps"),
        (("--out", "/proc/forbidden/x"), "cannot create"),
        (("--nonsense-option", "1"), "nonsense-option"),
    ],
)
def test_bad_options_are_named(tmp_path, arguments, message):
    result = complete(SAMPLE, tmp_path / "out", *arguments)
    assert result.returncode == 2
    assert message in result.stderr + result.stdout
    assert "Traceback" not in result.stderr


def test_records_that_cannot_hold_new_splats_are_refused_before_the_run(tmp_path):
    path = tmp_path / "integers.ply"
    path.write_bytes(make_ply(random_table(200, 0), types={"opacity": "uchar"}))
    result = complete(path, tmp_path / "out")
    assert result.returncode == 2
    assert "integer-typed opacity" in result.stderr
    assert not (tmp_path / "out").exists()


def test_what_is_odd_about_the_file_is_told(tmp_path):
    data = SAMPLE.read_bytes()
    (tmp_path / "longer.ply").write_bytes(data + b"rest")
    assert read_splats(tmp_path / "longer.ply").warnings
    told = ("--prompt", "xyzzy plugh", "--out", tmp_path / "out")
    result = run_here("complete", tmp_path / "longer.ply", *told, *WITHOUT_STEPS)
    assert result.returncode == 0, result.stderr
    (warning,) = read_splats(tmp_path / "longer.ply").warnings
    assert f"longer.ply: {warning}" in result.stdout
    assert "xyzzy" in result.stdout
    assert "not mirrored" in result.stdout


def test_prompts_without_sense(tmp_path):
    empty = run_here("complete", SAMPLE, "--prompt", " ", "--out", tmp_path / "a")
    assert empty.returncode == 2
    assert "--prompt" in empty.stderr
    missing = run_here("complete", SAMPLE, "--out", tmp_path / "b")
    assert missing.returncode == 2
    assert "--prompt" in missing.stderr + missing.stdout


def test_the_default_takes_the_first_guess_and_holds_it_to_bounds(tmp_path):
    out = tmp_path / "guess"
    more = ("--preserve", "0.001,0.001", "--match-seam", "--negative-prompt", "a handle")
    result = run_here("complete", SAMPLE, "--prompt", "a red mug", "--out", out, *more)
    assert result.returncode == 0, result.stderr
    content = json.loads((out / "run.json").read_text())
    assert content["result"]["new_splats"] > 1000
    assert content["result"]["metrics"]["all_views"]["color"] <= 0.001
    assert content["result"]["hard_preservation"]["met"]
    assert content["result"]["seam_colors"]["changed"] > 0
    assert "bounds on E_color and E_depth (over " in result.stdout
    assert any("that the prior guesses" in note for note in content["notes"])
    assert any("negative prompt: has no effect" in note for note in content["notes"])
    assert (out / "log.jsonl").read_text() == ""


def test_the_plane_of_symmetry_can_be_chosen(tmp_path):
    """P is cut through its middle; --preset fast takes the first guess as it is."""
    part = tmp_path / "part.ply"
    write_splats(part, shell(3000))
    how = ("--prompt", "a red ball", "--preset", "fast")

    def mirrored(name: str, *more: str) -> dict:
        out = tmp_path / name
        result = run_here("complete", part, "--out", out, *how, *more)
        assert result.returncode == 0, result.stderr
        return json.loads((out / "run.json").read_text())

    guessed = mirrored("guessed", "--alternatives", "2")
    *planes, cut, last = guessed["result"]["alternatives"]
    assert len(planes) == 2
    assert cut == "--mirror=cut"
    assert last == "--mirror=none"
    assert (tmp_path / "guessed" / "alternatives.png").stat().st_size > 10_000
    azimuth_deg, offset = map(float, planes[1].removeprefix("--mirror=").split(","))
    assert any("(--mirror)" in note for note in guessed["notes"])
    chosen = mirrored("chosen", planes[1])
    plane = {"azimuth_deg": azimuth_deg, "offset": offset}
    assert chosen["identity"]["settings"]["mirror"] == plane
    upright = f"mirror image is added: upright plane {azimuth_deg:.1f},{offset:.3f}"
    assert any(upright in note for note in chosen["notes"])
    half = mirrored("half", cut)
    assert half["identity"]["settings"]["mirror"] == {"toward_deg": None}
    assert any(
        "P is one half: mirrored through the plane that it ends at" in note
        for note in half["notes"]
    )
    sizes = [content["result"]["new_splats"] for content in (guessed, chosen, half)]
    assert min(sizes) > 100


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--mirror", "left"), "--mirror: expected guess, none, cut, cut:AZIMUTH or"),
        (("--mirror", "0,3"), "offset: expected -1 to 1"),
        (("--mirror", "none", "--preset", "paper"), "found preset paper with prior embedded"),
        (("--alternatives", "9"), "--alternatives: expected 0 to 8"),
        (
            ("--alternatives", "2", "--text-only"),
            "expected a run that starts from a guess of the complete object",
        ),
    ],
)
def test_planes_that_make_no_sense_are_refused(tmp_path, options, message):
    out = tmp_path / "out"
    result = run_here("complete", SAMPLE, "--prompt", "a mug", "--out", out, *options)
    assert result.returncode == 2
    assert message in " ".join(result.stderr.split())
    assert not out.exists()
