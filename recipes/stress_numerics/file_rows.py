"""Rows about files: extremes there and back, and files of millions of splats."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from gscomplete.render import render
from gscomplete.splats import Splats, load_splats, read_splats, write_splats
from gscomplete.splats.filters import usable_rows
from gscomplete.splats.ply import append_splats
from gscomplete.splats.validation import validate_file
from recipes.stress_numerics.rows import Check, Row, draw_and_differentiate, nonfinite
from recipes.stress_numerics.scenes import random_splats, ring, with_fields


def _extremes() -> Splats:
    """Return finite splats whose values span what float32 holds."""
    base = random_splats(3000, 40, degree=3)
    powers = 10.0 ** torch.linspace(-44, 37, 3000)[:, None]
    means = torch.sign(base.means) * powers
    scales = (10.0 ** torch.linspace(-8, 3, 3000))[:, None].expand(3000, 3).clone()
    scales[::7, 1] = 0.0
    opacities = base.opacities.clone()
    opacities[::5], opacities[1::5], opacities[2::5] = 0.0, 1.0, 1e-42
    quaternions = base.quaternions * 10.0 ** torch.linspace(-30, 30, 3000)[:, None]
    return Splats(means, quaternions, scales, opacities, base.sh * 1e3)


def _round_trip(quick: bool) -> Iterator[Check]:
    before = _extremes()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "extremes.ply"
        write_splats(path, before)
        source = read_splats(path)
        after = source.splats
        yield Check("splats lost", abs(len(after) - len(before)), 0)
        yield Check("positions changed", int((after.means != before.means).sum()), 0)
        yield Check("harmonics changed", int((after.sh != before.sh).sum()), 0)
        positive = before.scales > 0
        ratio = (after.scales / before.scales)[positive] - 1
        yield Check("scales, relative", float(ratio.abs().max()), 2e-6)
        yield Check("scales of 0 become", float(after.scales[~positive].max()), 1.1e-20)
        error = (after.opacities - before.opacities).abs().max()
        yield Check("opacities", float(error), 1e-6)
        unit = before.quaternions.double()
        unit = unit / unit.norm(dim=1, keepdim=True)
        yield Check("quaternions", float((after.quaternions - unit).abs().max()), 1e-6)
        yield from _appended(path, source, before)
        yield from _files_with_infinities(Path(name))


def _appended(path: Path, source: object, before: Splats) -> Iterator[Check]:
    """Append to a file and check that its records stay."""
    longer = path.with_name("longer.ply")
    append_splats(longer, source, before.select(torch.arange(10)))  # type: ignore[arg-type]
    old = bytes(read_splats(path).payload.records)
    new = read_splats(longer)
    kept = bytes(new.payload.records)[: len(old)] == old
    yield Check("old records changed by appending", int(not kept), 0)
    yield Check("rows after appending", abs(new.n_rows - len(before) - 10), 0)


def _files_with_infinities(folder: Path) -> Iterator[Check]:
    """Write raw infinities and NaN into records: read, named by validate, kept out of the set."""
    path = folder / "raw.ply"
    write_splats(path, random_splats(200, 41))
    data = bytearray(path.read_bytes())
    head = data.index(b"end_header\n") + len(b"end_header\n")
    table = np.frombuffer(data, "<f4", offset=head).reshape(200, -1)
    names = [line.split()[-1] for line in data[:head].decode().splitlines() if "property" in line]
    place = {name: i for i, name in enumerate(names)}
    table[0, place["opacity"]], table[1, place["opacity"]] = np.inf, -np.inf
    table[2, place["scale_0"]], table[3, place["scale_0"]] = -np.inf, np.inf
    table[4, place["x"]] = np.nan
    table[5, place["f_dc_0"]] = 1e30
    table[6, place["rot_0"] : place["rot_0"] + 4] = 0.0
    path.write_bytes(bytes(data))
    splats = load_splats(path)
    yield Check("opacity of logit +inf", abs(float(splats.opacities[0]) - 1), 0)
    yield Check("opacity of logit -inf", float(splats.opacities[1]), 0)
    keep, reasons = usable_rows(splats)
    yield Check("unusable rows (3) without a reason", abs(sum(reasons.values()) - 3), 0)
    picture = render(splats.select(keep), ring())
    yield Check("picture: non-finite values", nonfinite(picture.color, picture.depth), 0)
    found = {finding.name: finding.count for finding in validate_file(path).findings}
    expected = {"nan": 1, "infinite": 2, "infinite_opacity": 1, "infinite_scale": 1, "too_large": 1}
    expected["zero_quaternions"] = 1
    missed = sum(found.get(name) != count for name, count in expected.items())
    yield Check("findings of validate that are missing", missed, 0)


def _millions(quick: bool) -> Iterator[Check]:
    count = 200_000 if quick else 5_000_000
    command = [sys.executable, "-m", "recipes.stress_numerics.file_rows", str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    measured = json.loads(done.stdout)
    yield Check("rows lost", abs(measured.pop("rows") - count), 0)
    yield Check("memory above the start (bytes per splat)", measured.pop("bytes_per_splat"), 1000)
    for name, seconds in measured.items():
        yield Check(f"{name} (s)", seconds, 5 + 4e-5 * count)


def measure_many(count: int) -> dict[str, float]:
    """Write, load, validate and render many splats; return seconds, rows and peak memory."""
    with torch.no_grad():
        render(random_splats(2, 0), ring(8))  # compiled kernels are not what is measured
    before = _peak_bytes()
    splats = with_fields(random_splats(count, 42), scales=0.002)
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "many.ply"
        found["write"] = _seconds(lambda: write_splats(path, splats))
        found["load"] = _seconds(lambda: load_splats(path))
        found["validate"] = _seconds(lambda: found.update(rows=validate_file(path).n_splats))
        found["render 512 x 512"] = _seconds(lambda: _drawn(splats))
    return {**found, "bytes_per_splat": (_peak_bytes() - before) / count}


def _drawn(splats: Splats) -> None:
    """Render one view and check that it is a picture."""
    with torch.no_grad():
        picture = render(splats, ring(512)[0])
    if nonfinite(picture.color, picture.depth) or not bool(picture.alpha.max() > 0.5):
        raise AssertionError("the picture is empty or not finite")


def _seconds(action: Callable[[], object]) -> float:
    """Return how long a call takes."""
    started = time.perf_counter()
    action()
    return time.perf_counter() - started


def _peak_bytes() -> int:
    """Return the largest resident size of this process so far.

    Linux hands a process's ``ru_maxrss`` on to the programs it starts; ``VmHWM`` begins anew.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
    return int(line.split()[1]) * 1024


def _covering(quick: bool) -> Iterator[Check]:
    covering = with_fields(random_splats(2000, 43), scales=50.0, opacities=0.02)
    picture, grads = draw_and_differentiate(covering, ring(128)[0], "cpu")
    broken = nonfinite(picture.color, picture.depth, *grads.values())
    yield Check("non-finite values", broken, 0)
    yield Check("alpha above 1", float(picture.alpha.detach().max()) - 1, 0)


FILE_ROWS = (
    Row("PLY", "3,000 extremes written, read, appended; raw infinities", _round_trip),
    Row("covering splats", "2,000 splats, each over the whole picture", _covering),
    Row("millions", "5,000,000 splats (--quick: 200,000)", _millions),
)
"""Rows about files and sizes."""

if __name__ == "__main__":
    json.dump(measure_many(int(sys.argv[1])), sys.stdout)
