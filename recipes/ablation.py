"""The paper's ablation on real objects: ``python -m recipes.ablation --out DIR``.

Score distillation with the prior in text-only mode, once with everything and once without
preservation loss, timestep schedule and warm-up (Table 2, last against first row). Same objects,
seed and steps; the ratio of the mean E_color is printed.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from recipes.entry_point import start
from recipes.real_objects import complete

OBJECTS = (
    "apple",
    "blue_mug",
    "bowl",
    "cow",
    "bottle",
    "biker",
    "scan_cake_tin",
    "scan_yellow_bowl",
)


@dataclass(frozen=True)
class Options:
    """Ablate preservation loss, timestep schedule and warm-up."""

    out: Path
    """Folder: ``full/`` and ``ablated/`` with run folders, and ``ablation.json``."""
    names: tuple[str, ...] = OBJECTS
    """Objects by name."""
    data: Path = complete.DATA
    """Folder of the real data."""
    steps: int = 200
    """Steps of score distillation."""
    seed: int = 0


def main(options: Options) -> None:
    """Run both variants and compare."""
    means = {}
    for variant, ablate in (("full", False), ("ablated", True)):
        folder = options.out / variant
        sys.stdout.write(f"{variant}\n")
        complete.main(
            complete.Options(
                out=folder,
                names=options.names,
                data=options.data,
                preset="distill",
                text_only=True,
                ablate=ablate,
                steps=options.steps,
                seed=options.seed,
            )
        )
        rows = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        keys = ("e_color_c", "e_color_v", "e_depth_c", "e_depth_v")
        means[variant] = {key: sum(row[key] for row in rows) / len(rows) for key in keys}
    ratios = {key: means["ablated"][key] / value for key, value in means["full"].items()}
    content = {"steps": options.steps, "objects": options.names, **means, "ratios": ratios}
    (options.out / "ablation.json").write_text(json.dumps(content, indent=1) + "\n")
    for key, ratio in ratios.items():
        sys.stdout.write(
            f"{key}: full {means['full'][key]:.6f}, ablated {means['ablated'][key]:.6f}, "
            f"{ratio:.1f} times lower\n"
        )


if __name__ == "__main__":
    start(main, Options, __doc__)
