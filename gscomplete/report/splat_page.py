"""Write one set of splats as an HTML file that shows it without a network.

Conventions
-----------
* As ``page``: everything is inside the file, and texts of users only ever become text.
* Splats are packed as ``packed_splats`` does, in an object frame.
"""

from __future__ import annotations

from pathlib import Path

from gscomplete.report.packed_splats import LARGEST, REACH, SMALLEST, packed
from gscomplete.report.page import asset, embedded, escaped
from gscomplete.splats import Splats
from gscomplete.splats.transform import transform_splats
from gscomplete.util.atomic import atomic_path
from gscomplete.views import ObjectFrame

_VIEW_DEG = (30.0, 15.0)
"""Azimuth and elevation at the start."""


def write_splat_page(
    path: Path, splats: Splats, frame: ObjectFrame, title: str, most_splats: int
) -> tuple[str, ...]:
    """Write a page that shows splats; return what is lost.

    Args:
        path: destination, replaced atomically.
        splats: finite splats in the file frame.
        frame: the object frame: its z points up on the page, and its size fits the window.
        title: of the page.
        most_splats: most splats to show, 23 bytes each; of more, an evenly spaced subset is shown,
            its scales enlarged to close the gaps.

    Raises:
        UserError: the file cannot be written.
    """
    moved = transform_splats(splats.with_sh_degree(0), frame.object_from_file)
    shown = packed(moved, most_splats)
    count = shown["count"]
    azimuth_deg, elevation_deg = _VIEW_DEG
    content = {
        "splats": shown,
        "packing": {"reach": REACH, "smallest": SMALLEST, "largest": LARGEST},
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
    }
    style, viewer, script = map(asset, ("splat_page.css", "viewer.js", "splat_page.js"))
    about = f"{escaped(title)} \u00b7 {count:,} splats \u00b7 drag, wheel; double-click turns"
    text = "\n".join(
        (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width">',
            '<link rel="icon" href="data:,">',
            f"<title>{escaped(title)}</title><style>{style}</style></head><body><p>{about}</p>",
            f'<script id="data" type="application/json">{embedded(content)}</script>',
            f"<script>{viewer}</script><script>{script}</script></body></html>",
            "",
        )
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    lost = ["8-bit colours, scales and rotations, 16-bit positions"]
    if splats.sh_degree:
        lost.append(f"harmonics of degree {splats.sh_degree}")
    if count < len(splats):
        lost.append(f"{len(splats) - count:,} of {len(splats):,} splats (faint, far, or too many)")
    return tuple(lost)
