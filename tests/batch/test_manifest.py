import json
import time
import tracemalloc

import pytest

from gscomplete.batch.manifest import Item, plan
from gscomplete.errors import UserError

FIELDS = {"prompt": str, "size": float, "seed": int, "up": ("Y", "Z")}


def planned(path) -> list[Item]:
    return plan(str(path), FIELDS)


def test_a_manifest_of_json_lines_names_objects_and_their_options(tmp_path):
    path = tmp_path / "list.jsonl"
    path.write_text(
        '{"partial": "mug.ply", "prompt": "a mug", "size": 2, "up": "Y"}\n\n'
        '{"partial": "/data/cow/", "id": "spot", "seed": 7, "prompt": null}\n'
        '{"partial": "s3://bucket/owl", "id": "owl"}\n'
    )
    assert planned(path) == [
        Item("mug", f"{tmp_path}/mug.ply", {"prompt": "a mug", "size": 2.0, "up": "Y"}),
        Item("spot", "/data/cow", {"seed": 7}),
        Item("owl", "s3://bucket/owl", {}),
    ]


@pytest.mark.parametrize(("suffix", "tab"), [("csv", ","), ("tsv", "\t")])
def test_a_table_is_the_same_manifest(tmp_path, suffix, tab):
    path = tmp_path / f"list.{suffix}"
    rows = [("partial", "prompt", "size"), ("mug.ply", "a mug", "2.5"), ("cow", "", "")]
    path.write_text("\n".join(tab.join(row) for row in rows))
    assert planned(path) == [
        Item("mug", f"{tmp_path}/mug.ply", {"prompt": "a mug", "size": 2.5}),
        Item("cow", f"{tmp_path}/cow", {}),
    ]


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize(
    ("suffix", "text"),
    [("csv", "partial,size\r\nmug.ply,2\r\n"), ("jsonl", '{"partial": "mug.ply", "size": 2}\n')],
)
def test_a_byte_order_mark_is_no_part_of_a_manifest(tmp_path, suffix, text, far):
    """Excel writes one into "CSV UTF-8"."""
    if far:
        pytest.importorskip("fsspec")
    path = tmp_path / f"list.{suffix}"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    (item,) = plan(f"file://{path}" if far else str(path), FIELDS)
    assert (item.id, item.options) == ("mug", {"size": 2.0})


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "list.jsonl:2: expected a JSON object"),
        ("[]", "list.jsonl:2: expected a JSON object"),
        ('{"id": "a"}', "list.jsonl:2: partial: expected a splat file"),
        ('{"partial": "a.ply", "sise": 2}', "list.jsonl:2: unknown field 'sise'"),
        ('{"partial": "a.ply", "size": "big"}', "list.jsonl:2: size: expected a number"),
        ('{"partial": "a.ply", "seed": 1.5}', "list.jsonl:2: seed: expected an integer"),
        ('{"partial": "a.ply", "seed": true}', "list.jsonl:2: seed: expected an integer"),
        ('{"partial": "a.ply", "up": "Q"}', "list.jsonl:2: up: expected one of Y, Z"),
        ('{"partial": "a.ply", "prompt": 3}', "list.jsonl:2: prompt: expected a text"),
        ('{"partial": "a.ply", "id": "../a"}', "id: expected a plain name"),
        ('{"partial": "a.ply", "id": ".batch"}', "id: expected a plain name"),
        ('{"partial": "b/first.ply"}', "found 'first' twice"),
        ('{"partial": "a.ply", "seed": 1, "seed": 2}', "list.jsonl:2: expected a JSON object (exp"),
    ],
)
def test_what_is_wrong_with_a_line_is_said(tmp_path, line, message):
    path = tmp_path / "list.jsonl"
    path.write_text('{"partial": "first.ply"}\n' + line)
    with pytest.raises(UserError) as caught:
        planned(path)
    assert message in str(caught.value)


def test_a_folder_is_its_object_folders_and_splat_files(tmp_path):
    for name in ("cow", "owl", ".hidden", "other"):
        (tmp_path / name).mkdir()
    for name in ("cow", "owl", ".hidden"):
        (tmp_path / name / "object.json").touch()
    for name in ("mug.ply", "._mug.ply", "notes.txt", "bee.spz", "jug.compressed.ply", "cup.glb"):
        (tmp_path / name).touch()
    assert [item.id for item in planned(tmp_path)] == ["cow", "owl", "bee", "cup", "jug", "mug"]
    (tmp_path / "mug.splat").touch()
    with pytest.raises(UserError, match="'mug' twice"):
        planned(tmp_path)


def test_a_dataset_is_what_its_index_lists(tmp_path):
    (tmp_path / "dataset.json").write_text(json.dumps({"objects": [{"id": "b"}, {"id": "a"}]}))
    assert planned(tmp_path) == [Item("b", f"{tmp_path}/b"), Item("a", f"{tmp_path}/a")]
    assert planned(tmp_path / "dataset.json") == planned(tmp_path)


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("partial,prompt,prompt\na.ply,cow,dog\n")
    with pytest.raises(
        UserError, match=r"a\.csv:1: expected every name once, found 'prompt' again"
    ):
        planned(tmp_path / "a.csv")


def test_a_quote_that_is_not_closed_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('partial,prompt\na.ply,"a cow\nb.ply,a dog\n')
    with pytest.raises(UserError, match=r"a\.csv:2: unexpected end of data \(is a quote"):
        planned(path)
    path.write_text('partial,prompt\na.ply,a 5" pipe\nb.ply,"a dog, black"\n')
    assert [item.options["prompt"] for item in planned(path)] == ['a 5" pipe', "a dog, black"]


@pytest.mark.parametrize("name", ["missing", "missing.jsonl", ""])
def test_nothing_to_do_is_an_error(tmp_path, name):
    with pytest.raises(UserError):
        planned(tmp_path / name)


def test_a_store_is_planned_as_a_folder_is(tmp_path):
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    for name in ("cow/object.json", "cow/partial.ply", "mug.ply", "list.jsonl"):
        store.pipe(f"/planned/{name}", b'{"partial": "mug.ply"}')
    assert plan("memory://planned/", FIELDS) == [
        Item("cow", "memory://planned/cow"),
        Item("mug", "memory://planned/mug.ply"),
    ]
    assert plan("memory://planned/list.jsonl", FIELDS) == [Item("mug", "memory://planned/mug.ply")]


def test_a_hundred_thousand_objects_are_planned_in_seconds(tmp_path):
    path, few = tmp_path / "list.jsonl", tmp_path / "few.jsonl"
    rows = [
        json.dumps({"partial": f"objects/{n:06}", "prompt": f"object {n}", "seed": n}) + "\n"
        for n in range(100_000)
    ]
    path.write_text("".join(rows))
    started = time.process_time()
    items = planned(path)
    assert time.process_time() - started < 5
    assert items[-1].options == {"prompt": "object 99999", "seed": 99999}
    few.write_text("".join(rows[:5000]))
    tracemalloc.start()
    planned(few)
    assert 20 * tracemalloc.get_traced_memory()[1] < 250e6
    tracemalloc.stop()
