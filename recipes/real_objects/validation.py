"""Objects to choose settings on: ``python -m recipes.real_objects.validation --out DIR``.

The real objects with known truth that ``compare`` does not use are each cut in three ways,
completed, and compared with the truth as in ``compare``. Tune a run's rules and settings on these,
never on the benchmark. There are many cuts on purpose: a rule that was tuned on 45 other cuts of
the same objects improved those and made these worse.

Conventions
-----------
* The first part of an object is the table's; the other two are an upright plane elsewhere and what
  a scanner sees from one or two sides. All are fixed.
* Slight parts lack little: what a scanner misses from four sides, what it misses from three sides
  above, and nothing. A completion should add as little.
* A turned object is turned about its up axis, as captures are, after it was cut.
* Random parts: a plane for two of three, else what a scanner sees from one or two sides; turned.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

from gscomplete.errors import UserError
from gscomplete.framing.input_view import hidden_share
from gscomplete.priors import load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.splats import concatenate
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import up_rotation
from recipes.entry_point import start
from recipes.real_objects.catalogue import ENTRIES, BoxCut, Cut, Entry, PlaneCut, ScanCut
from recipes.real_objects.compare import (
    OBJECTS,
    FramedObject,
    Outcome,
    completed_as_run,
    frame_object,
    mean_of_known,
    measure,
    settings_of,
)
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import RealObject, load_entry
from recipes.results import Results
from recipes.train_embedded_prior.procedural.quads import turn_about

_OFFSETS = (-0.04, 0.0, 0.05)
_TURN_DEG = (15.0, 75.0)
_NOTHING = 2.0
"""Offset of a plane farther out than any object reaches."""


@dataclass(frozen=True)
class Options:
    """Complete parts of real objects that no benchmark uses and measure the results."""

    out: Path
    """Folder for ``PRESET.json`` (``PRESET-slight-turned.json`` and so on); an interrupted run goes
    on from it."""
    preset: Literal["fast", "default", "reconstruct"] = "fast"
    """Settings of the completion."""
    slight: bool = False
    """Complete parts that lack little or nothing instead."""
    turned: bool = False
    """Turn every object about its up axis by 15 to 75 degrees."""
    random: int = 0
    """Cut every object so many times at random instead, and turn it by any angle."""
    data: Path = DATA
    """Folder of the real data."""


def parts(*, slight: bool = False) -> list[Entry]:
    """Return the parts, three of each object; slight ones lack little."""
    cuts = slight_cuts_of if slight else cuts_of
    return [
        dataclasses.replace(entry, name=f"{entry.name}-{n}", cut=cut)
        for k, entry in enumerate(_objects())
        for n, cut in enumerate(cuts(entry, k))
    ]


def _objects() -> list[Entry]:
    """Return the objects that ``compare`` leaves alone."""
    return [e for e in ENTRIES if e.source != "scan" and e.name not in OBJECTS]


def random_parts(count: int) -> list[tuple[Entry, float]]:
    """Return so many random parts of each object, and the angles that they are turned by."""
    found = []
    for n in range(count):
        for k, entry in enumerate(_objects()):
            random = np.random.default_rng((k, n, 1234))
            side_deg = float(random.uniform(0.0, 360.0))
            cut: Cut
            if random.integers(0, 3) < 2:
                cut = PlaneCut(side_deg, float(random.uniform(-0.12, 0.12)))
            elif random.uniform() < 0.5:
                cut = ScanCut((side_deg,))
            else:
                cut = ScanCut((side_deg, side_deg + float(random.uniform(30.0, 90.0))))
            part = dataclasses.replace(entry, name=f"{entry.name}-r{n}", cut=cut)
            found.append((part, float(random.uniform(0.0, 360.0))))
    return found


def cuts_of(entry: Entry, number: int) -> tuple[Cut, Cut, Cut]:
    """Return the cuts of object ``number``."""
    assert entry.cut is not None
    away_deg = side_taken_away_deg(entry.cut)
    plane = PlaneCut(away_deg + 70.0 + 13.0 * number, _OFFSETS[number % 3])
    first = away_deg + 40.0 + 29.0 * number
    scan = ScanCut((first,) if number % 2 else (first, first + 45.0))
    return entry.cut, plane, scan


def slight_cuts_of(entry: Entry, number: int) -> tuple[Cut, Cut, Cut]:
    """Return the cuts of object ``number`` that leave nearly all of its outside."""
    assert entry.cut is not None
    away_deg = side_taken_away_deg(entry.cut) + 29.0 * number
    four = ScanCut(tuple(away_deg + turn for turn in (0.0, 90.0, 180.0, 270.0)))
    three = ScanCut(tuple(away_deg + turn for turn in (0.0, 120.0, 240.0)), elevation_deg=50.0)
    return four, three, PlaneCut(away_deg, _NOTHING)


def side_taken_away_deg(cut: Cut) -> float:
    """Return the azimuth of the side that a cut takes away."""
    if isinstance(cut, PlaneCut):
        return cut.toward_deg
    return 180.0 if isinstance(cut, BoxCut) else cut.from_deg[0] + 180.0


def turned_object(item: RealObject, angle_deg: float) -> RealObject:
    """Turn an object and its part about the up axis."""
    assert item.complete is not None
    up = up_rotation(item.up).double()
    turn = torch.from_numpy(turn_about("z", angle_deg)).double()
    similarity = Similarity(1.0, up.T @ turn @ up, torch.zeros(3).double())
    return dataclasses.replace(
        item,
        partial=transform_splats(item.partial, similarity),
        complete=transform_splats(item.complete, similarity),
    )


def chosen_parts(options: Options) -> list[tuple[Entry, float]]:
    """Return the parts that are asked for and the angles that they are turned by.

    Raises:
        UserError: options that exclude each other.
    """
    if options.random:
        if options.slight or options.turned:
            raise UserError("--random: expected without --slight and --turned")
        return random_parts(options.random)
    entries = parts(slight=options.slight)
    angles = [
        float(np.random.default_rng((index, 77)).uniform(*_TURN_DEG)) if options.turned else 0.0
        for index in range(len(entries))
    ]
    return list(zip(entries, angles, strict=True))


def views_settled(framed: FramedObject, outcome: Outcome) -> dict[str, Any]:
    """Return whether the run changed the input view, and how much of P the truth hides in both."""
    assert framed.truth is not None
    partial = framed.partial.with_sh_degree(0)
    together = concatenate([partial, framed.truth.with_sh_degree(0)])
    return {
        "view_gave_way": outcome.views != framed.views,
        "truth_hides_from_guessed_view": hidden_share(partial, together, framed.views),
        "truth_hides_from_view": hidden_share(partial, together, outcome.views),
    }


def main(options: Options) -> None:
    """Complete and measure."""
    prior = load_prior("embedded", "cpu")
    settings = settings_of(options.preset, prior, 0)
    kind = ("-slight" if options.slight else "") + ("-turned" if options.turned else "")
    kind += f"-random{options.random}" if options.random else ""
    made_with = {"prior": prior_identity(prior), "settings": settings}
    results = Results(options.out / f"{options.preset}{kind}.json", made_with)
    rows = results.rows
    chosen = chosen_parts(options)
    for entry, angle_deg in track(chosen, "parts", console=Console(file=sys.stderr)):
        if entry.name in rows:
            continue
        item = load_entry(entry, options.data)
        framed = frame_object(turned_object(item, angle_deg) if angle_deg else item, prior)
        outcome = completed_as_run(framed, prior, settings)
        rows[entry.name] = measure(framed, outcome) | views_settled(framed, outcome)
        results.save()
    sys.stdout.write(table(rows))


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Show every part's silhouettes, then the means."""
    keys = ("silhouette_iou", "hidden_iou", "hidden_color_psnr_db", "seconds")
    lines = [f"{name:18}{row['silhouette_iou']:8.3f}" for name, row in rows.items()]
    for key in keys:
        values = [row[key] for row in rows.values()]
        known = sum(value is not None for value in values)
        lines.append(f"mean {key:22}{mean_of_known(values, '9.4f')} over {known}")
    moved = [row for row in rows.values() if row["view_gave_way"]]
    lines.append(f"input views that gave way: {len(moved)} of {len(rows)}")
    if moved:
        keys = ("truth_hides_from_guessed_view", "truth_hides_from_view")
        before, after = (np.mean([row[key] for row in moved]) for key in keys)
        less = sum(row[keys[1]] < row[keys[0]] for row in moved)
        lines.append(f"of P the truth hides from them {before:.3f}, then {after:.3f}; less: {less}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    start(main, Options, __doc__)
