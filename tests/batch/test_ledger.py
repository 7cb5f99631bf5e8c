from gscomplete.batch.ledger import Ledger, Row, read_ledger


def test_the_last_row_of_an_object_counts(tmp_path):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.add(Row("a", "failed", error="no"))
    ledger.add(Row("b", "finished", inputs=[[3, "4"], None], facts={"new_splats": 5}))
    ledger.add(Row("a", "finished", attempts=2))
    ledger.close()
    rows = read_ledger(tmp_path / "ledger.jsonl")
    assert rows["a"] == Row("a", "finished", attempts=2)
    assert rows["b"].inputs == [[3, "4"], None]


def test_a_line_cut_off_by_a_kill_costs_only_itself(tmp_path):
    path = tmp_path / "ledger.jsonl"
    path.write_text('{"id": "a", "status": "finished"}\n[1]\n{"id": "b", "sta')
    assert list(read_ledger(path)) == ["a"]
    ledger = Ledger(path)
    ledger.add(Row("c", "finished"))
    ledger.close()
    assert list(read_ledger(path)) == ["a", "c"]
    assert read_ledger(tmp_path / "missing.jsonl") == {}


def test_numbers_that_no_ledger_holds_are_damage(tmp_path):
    path = tmp_path / "ledger.jsonl"
    rows = [f'{{"id": "{n}", "status": "finished", "facts": {{"x": {n}}}}}' for n in
            ("NaN", "-Infinity", "1e400", "1e30", "7")]  # fmt: skip
    path.write_text("\n".join(rows))
    assert list(read_ledger(path)) == ["1e30", "7"]
