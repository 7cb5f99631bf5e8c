"""Check a dataset, or one object folder: every file, hash, count, schema, view and frame.

Conventions
-----------
* Every fault is a named finding with the object it belongs to; nothing raises.
* ``error``: the object cannot be trusted or used; ``warning``: usable, but probably not meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, read_splats
from gscomplete.splats.validation import validate_file
from gscomplete.util import jsonio
from gscomplete.util.digests import sha256_of
from gscomplete.util.file_names import DATASET_FILE
from splatcomplete_data.dataset.build import INDEX_SCHEMA
from splatcomplete_data.objects import (
    COMPLETE_FILE,
    PARTIAL_FILE,
    PREVIEW_FILE,
    RECORD_FILE,
    ObjectRecord,
    read_record,
)

Severity = Literal["error", "warning"]
FRAME_SLACK = 1.1
"""Splats may reach this far beyond half the object frame's size in every direction."""
FEW_SPLATS = 1000


@dataclass(frozen=True, slots=True)
class ObjectFinding:
    """One named fault of an object."""

    object: str
    name: str
    severity: Severity
    message: str


def object_folders(dataset: Path) -> list[Path]:
    """Return the object folders of a dataset, or the folder itself if it is one.

    Raises:
        UserError: there is none.
    """
    if not dataset.is_dir():
        raise UserError(f"{dataset}: expected a dataset or object folder, found none")
    if (dataset / RECORD_FILE).exists():
        return [dataset]
    children = sorted(path for path in dataset.iterdir() if path.is_dir())
    folders = [path for path in children if not path.name.startswith(".")]
    if not folders:
        raise UserError(f"{dataset}: expected object folders, found none")
    return folders


def read_index(dataset: Path) -> dict[str, str] | None:
    """Return the SHA-256 of each object.json by id, as the last build listed its recipe's objects.

    None = there is no ``dataset.json``.

    Raises:
        UserError: it is not what it should be.
    """
    path = dataset / DATASET_FILE
    if not path.is_file():
        return None
    data = jsonio.read_json(path)
    try:
        if data["schema"] != INDEX_SCHEMA:
            raise KeyError("schema")
        return {str(row["id"]): str(row["object_sha256"]) for row in data["objects"]}
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: expected the index of a dataset ({error!r})") from error


def validate_dataset(dataset: Path) -> tuple[int, list[ObjectFinding]]:
    """Check a dataset.

    Returns:
        The number of objects and all findings.

    Raises:
        UserError: there is no object folder at all.
    """
    folders = object_folders(dataset)
    findings: list[ObjectFinding] = []
    records: dict[str, ObjectRecord] = {}
    for folder in folders:
        record, found = validate_object(folder)
        findings += (*found, *_check_links(dataset, folder))
        if record is not None:
            if record.id in records:
                message = f"id {record.id!r} is used by another folder too"
                findings.append(ObjectFinding(folder.name, "double_id", "error", message))
            records[record.id] = record
    findings += _same_parts(records)
    if folders != [dataset]:
        findings += _check_index(dataset, folders)
        files = sorted(path.name for path in dataset.iterdir() if not path.is_dir())
        for name in files:
            if name != DATASET_FILE and not name.startswith("."):
                message = f"{name}: no file of a dataset"
                findings.append(ObjectFinding("dataset", "unknown_file", "warning", message))
    return len(folders), findings


def validate_object(folder: Path) -> tuple[ObjectRecord | None, list[ObjectFinding]]:
    """Check one object folder."""
    try:
        record = read_record(folder)
    except UserError as error:
        return None, [ObjectFinding(folder.name, "bad_record", "error", str(error))]
    findings = [
        ObjectFinding(folder.name, name, severity, message)
        for name, severity, message in (
            *_check_files(folder, record),
            *_check_record(folder, record),
        )
    ]
    return record, findings


def _check_files(folder: Path, record: ObjectRecord) -> Iterator[tuple[str, Severity, str]]:
    """Check that the files are there, whole and splats."""
    present = {path.name for path in folder.iterdir()} - {RECORD_FILE}
    for name in sorted(set(record.files) - present):
        yield "missing_file", "error", f"{name}: listed in {RECORD_FILE}, not there"
    for name in sorted(present - set(record.files)):
        yield "unknown_file", "warning", f"{name}: not listed in {RECORD_FILE}"
    for name in (PREVIEW_FILE,):
        if name not in record.files:
            yield "missing_file", "error", f"{name}: not listed in {RECORD_FILE}"
    if not {PARTIAL_FILE, COMPLETE_FILE} & set(record.files):
        yield "missing_file", "error", f"expected {PARTIAL_FILE} or {COMPLETE_FILE}"
    for name in sorted(present & set(record.files)):
        expected, path = record.files[name], folder / name
        if path.stat().st_size != expected.bytes:
            found = f"expected {expected.bytes} bytes, found {path.stat().st_size}"
            yield "wrong_size", "error", f"{name}: {found}"
        elif sha256_of(path) != expected.sha256:
            yield "wrong_hash", "error", f"{name}: the SHA-256 is not the recorded one"
        if name.endswith(".ply"):
            report = validate_file(path)
            for finding in report.findings:
                if finding.severity == "error":
                    yield f"ply_{finding.name}", "error", f"{name}: {finding.message}"
            counted = record.counts.get(name.removesuffix(".ply"))
            if report.ok and counted != report.n_splats:
                yield "wrong_count", "error", f"{name}: {report.n_splats}, recorded {counted}"
            if report.ok and report.sh_degree != record.counts.get("sh_degree"):
                recorded = record.counts.get("sh_degree")
                yield "wrong_sh", "warning", f"{name}: {report.sh_degree}, recorded {recorded}"


def _check_record(folder: Path, record: ObjectRecord) -> Iterator[tuple[str, Severity, str]]:
    """Check that the record is consistent in itself and with the splats."""
    if record.id != folder.name:
        yield "other_name", "warning", f"id {record.id!r} in a folder called {folder.name!r}"
    for step in record.steps:
        if step.before - step.after != sum(step.reasons.values()) and step.before > step.after:
            yield "uncounted", "warning", f"step {step.name}: reasons do not add up"
    if record.source.licence is None:
        yield "no_licence", "warning", "source: no licence is recorded"
    found: dict[str, Splats] = {}
    for name in (COMPLETE_FILE, PARTIAL_FILE):
        if name in record.files and (folder / name).is_file():
            try:
                splats = found[name] = read_splats(folder / name).splats
            except UserError:
                continue  # named above
            if name == PARTIAL_FILE and 0 < len(splats) < FEW_SPLATS:
                yield "few_splats", "warning", f"{name}: only {len(splats)}"
            yield from _check_frame(name, splats, record)
    is_cut = any(step.name == "boxes" or step.name.startswith("cut_") for step in record.steps)
    if len(found) == 2 and is_cut:
        strays = _strays(found[PARTIAL_FILE], found[COMPLETE_FILE])
        if strays > 0:
            message = f"{PARTIAL_FILE}: {strays:,} splats lie where {COMPLETE_FILE} has none"
            yield "other_whole", "error", message
    counts = record.counts
    if "complete" in counts and counts.get("partial", 0) >= counts["complete"]:
        yield "part_is_whole", "error", f"partial has {counts.get('partial')} splats, complete less"


def _strays(part: Splats, whole: Splats) -> int:
    """Count the splats of a part whose position is not that of any splat of the whole."""
    rows = (np.ascontiguousarray(splats.means.numpy(), np.float32) for splats in (part, whole))
    of_part, of_whole = (values.view("V12").ravel().tolist() for values in rows)
    known = set(of_whole)
    return sum(position not in known for position in of_part)


def _check_frame(
    name: str, splats: Splats, record: ObjectRecord
) -> Iterator[tuple[str, Severity, str]]:
    """Check that the object frame contains the splats and that they fill it."""
    means = splats.means[splats.means.isfinite().all(dim=1)]
    if len(means) == 0:
        return
    moved = record.frame.object_from_file.apply(means.double())
    some = moved[:: max(1, len(moved) // 100_000)]
    low, high = torch.quantile(some, torch.tensor([0.01, 0.99], dtype=torch.float64), dim=0)
    reach = float(torch.maximum(low.abs(), high.abs()).max())
    if reach > 0.5 * FRAME_SLACK:
        message = f"{name}: splats reach {reach:.2f} from the centre, expected at most 0.5"
        yield "outside_frame", "warning", message
    if float((high - low).max()) < 0.2:
        yield "small_in_frame", "warning", f"{name}: fills less than a fifth of the object frame"


def _check_links(dataset: Path, folder: Path) -> Iterator[ObjectFinding]:
    """Find splat files that are links to somewhere outside the dataset."""
    for path in (folder / PARTIAL_FILE, folder / COMPLETE_FILE):
        if path.is_symlink() and not path.resolve().is_relative_to(dataset.resolve()):
            message = f"{path.name}: a link out of the dataset, to {path.resolve()}"
            yield ObjectFinding(folder.name, "outside_link", "warning", message)


def _same_parts(records: dict[str, ObjectRecord]) -> Iterator[ObjectFinding]:
    """Find objects with the same partial.ply."""
    seen: dict[str, str] = {}
    for name, record in records.items():
        file = record.files.get(PARTIAL_FILE)
        if file is not None:
            if file.sha256 in seen:
                message = f"the same {PARTIAL_FILE} as {seen[file.sha256]}"
                yield ObjectFinding(name, "double_part", "warning", message)
            seen[file.sha256] = name


def _check_index(dataset: Path, folders: list[Path]) -> Iterator[ObjectFinding]:
    """Check ``dataset.json`` against the folders."""
    try:
        listed = read_index(dataset)
    except UserError as error:
        yield ObjectFinding("dataset", "bad_index", "error", str(error))
        return
    if listed is None:
        yield ObjectFinding("dataset", "no_index", "warning", f"no {DATASET_FILE}")
        return
    names = {folder.name for folder in folders}
    for name in sorted(set(listed) - names):
        yield ObjectFinding(name, "missing_object", "error", f"listed in {DATASET_FILE}, not there")
    for name in sorted(names - set(listed)):
        yield ObjectFinding(name, "unlisted_object", "warning", f"not listed in {DATASET_FILE}")
    for name in sorted(names & set(listed)):
        record = dataset / name / RECORD_FILE
        if record.is_file() and sha256_of(record) != listed[name]:
            message = f"{RECORD_FILE} is not the one in {DATASET_FILE}"
            yield ObjectFinding(name, "changed_record", "error", message)
