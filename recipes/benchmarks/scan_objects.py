"""Cut labelled objects out of table-top scans: ``python -m recipes.benchmarks.scan_objects``.

Every object of the labelled scenes (Modified Object Segmentation Database) is cut twice, as a user
would: by a box (1st to 99th percentile of its points along the file's axes, plus 12 mm) with
``--level``, and by a seed point near its middle with ``--level``. Precision
is the share of the points kept that are labelled as the object, recall the share of its points that
are kept. Objects with fewer than 1,000 points are left out. An object touches another if they are
nearer than 10 mm.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.views import axis_direction
from recipes.entry_point import start
from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.scan.clean import CleanSettings, Surroundings
from splatcomplete_data.scan.make import PartSettings, make_part
from splatcomplete_data.scan.read import Scan, read_scan

FOLDER = "lidar/pcl/mOSD"
MARGIN = 0.012
TOUCHING = 0.010
FEWEST = 1000
_TABLE = 1


@dataclass(frozen=True)
class Options:
    """Cut labelled objects out of table-top scans by boxes and by seed points."""

    data: Path = Path("../shared/data")
    """Folder with MANIFEST.tsv."""
    out: Path | None = None
    """JSON file for every row; None = standard output alone."""


@dataclass(frozen=True)
class Row:
    """One cut."""

    scene: str
    label: int
    mode: str
    touches: bool
    precision: float
    recall: float
    up_deg: float | None
    """Angle between the levelled up and the true table's normal; None = no plane was found."""
    warnings: tuple[str, ...]


def main(options: Options) -> int:
    """Measure; return the exit code."""
    rows: list[Row] = []
    for path in sorted((options.data / FOLDER).glob("*.pcd")):
        scan = read_scan(path)
        assert scan.cloud.labels is not None
        for label in np.unique(scan.cloud.labels // 10):
            if label > _TABLE and (scan.cloud.labels // 10 == label).sum() >= FEWEST:
                rows += measured(path.stem, scan, int(label))
                for row in rows[-2:]:
                    sys.stdout.write(line(row) + "\n")
                    sys.stdout.flush()
    for mode in ("box", "seed"):
        for touches in (False, True):
            chosen = [r for r in rows if r.mode == mode and r.touches == touches]
            both = np.array([(r.precision, r.recall) for r in chosen]).reshape(-1, 2)
            least = 0.85 if touches else 0.95
            over = np.array([r.up_deg if r.up_deg is not None else 180.0 for r in chosen])
            sys.stdout.write(
                f"{mode}, {'touching' if touches else 'isolated'}: {len(chosen)} objects; mean "
                f"precision {both[:, 0].mean():.3f}, recall {both[:, 1].mean():.3f}; both at least "
                f"{least}: {(both >= least).all(axis=1).sum()}; more than 10 degrees from level: "
                f"{(over > 10).sum()}, upside down: {(over > 90).sum()}\n"
            )
    if options.out is not None:
        options.out.write_text(json.dumps([row.__dict__ for row in rows]))
    return 0


def measured(scene: str, scan: Scan, label: int) -> list[Row]:
    """Cut one object by a box and by a seed point."""
    cloud = scan.cloud
    assert cloud.labels is not None
    is_own = cloud.labels // 10 == label
    own = cloud.points[is_own]
    others = cloud.points[(cloud.labels // 10 > _TABLE) & ~is_own]
    touches = len(others) > 0 and float(cKDTree(others).query(own[::4])[0].min()) < TOUCHING
    low, high = np.percentile(own, [1, 99], axis=0)
    low, high = low - MARGIN, high + MARGIN
    box = CropBox(tuple((low + high) / 2), tuple((high - low) / 2))
    seed = own[int(np.square(own - np.median(own, axis=0)).sum(axis=1).argmin())]
    x, y, z = seed.tolist()
    table = cloud.points[cloud.labels // 10 < _TABLE + 1]
    around = Surroundings(scan.viewpoint, None if scan.up is None else axis_direction(scan.up))
    places = {tuple(row) for row in own.tolist()}  # of an organised cloud, no two are at one place
    rows = []
    for mode, settings in (
        ("box", PartSettings((box,), CleanSettings(clusters=0), "always")),
        ("seed", PartSettings((), CleanSettings(seed_point=(x, y, z), clusters=0), "always")),
    ):
        try:
            part = make_part(cloud, settings, scene, around)
        except ValueError as error:
            rows.append(Row(scene, label, mode, touches, 0.0, 0.0, None, (str(error),)))
            continue
        kept = part.cloud.points[part.reason < 0]
        hits = sum(tuple(row) in places for row in kept.tolist())
        assert part.turn is not None
        cosine = part.turn.rotation[2].numpy() @ true_up(table)
        angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        row = Row(
            scene, label, mode, touches, hits / len(kept), hits / len(own), angle, part.warnings
        )
        rows.append(row)
    return rows


def true_up(table: np.ndarray) -> np.ndarray:  # [N, 3] -> [3]
    """Return the normal of the labelled table, towards the scanner at the origin."""
    for _ in range(5):
        middle = table.mean(axis=0)
        normal = np.linalg.eigh(np.cov((table - middle).T))[1][:, 0]
        residual = np.abs((table - middle) @ normal)
        table = table[residual <= 3 * 1.4826 * np.median(residual)]
    return normal if normal @ -middle > 0 else -normal


def line(row: Row) -> str:
    """Describe a row."""
    kind = "touching" if row.touches else "isolated"
    up = "no plane" if row.up_deg is None else f"up {row.up_deg:.1f} degrees off"
    return (
        f"{row.scene} {row.label} {row.mode} {kind}: precision {row.precision:.3f}, recall "
        f"{row.recall:.3f}, {up}{'; ' if row.warnings else ''}{'; '.join(row.warnings)}"
    )


if __name__ == "__main__":
    start(main, Options, __doc__)
