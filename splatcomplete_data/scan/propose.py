"""Propose objects in a scan: what stands on its planes, numbered, drawn with axes and coordinates.

Conventions
-----------
* Seed points and boxes are in the source's frame, as the command's flags take them.
* Objects that touch are separated as for a seed point (``segments``), but by a single vote.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image, ImageDraw

from gscomplete.evaluate.pictures import LIGHT_GREY, contact_sheet, to_image
from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh, transform_splats
from gscomplete.util.arrays import Float64Array, IntArray
from gscomplete.views import Cameras, ObjectFrame, UpAxis, ViewDistribution
from splatcomplete_data.points import median_spacing, points_to_splats, thin_to_count
from splatcomplete_data.scan.clean import Surroundings
from splatcomplete_data.scan.cloud import PointCloud
from splatcomplete_data.scan.make import Part, PartSettings, make_part
from splatcomplete_data.scan.segments import VOTES, segment

_LEAST_SHARE = 0.004
_FEWEST_POINTS = 50
_MOST_CLUSTERS = 20
_MARGIN_SPACINGS = 7.0
"""Margin of a proposed box about its points, in spacings."""
_MOST_DRAWN = 120_000
_PALETTE = np.array(
    [(230, 60, 50), (50, 120, 230), (40, 170, 70), (240, 160, 20), (150, 70, 200), (20, 170, 180)]
)
_AXIS_COLORS = ((220, 30, 30), (20, 150, 20), (30, 60, 220))
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class ProposedCluster:
    """A cluster that is probably one object."""

    count: int
    seed: tuple[float, float, float]
    """One of its points, near its middle."""
    box: tuple[float, float, float, float, float, float]
    """Centre and half extents around it."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposed:
    """What was found."""

    part: Part
    clusters: tuple[ProposedCluster, ...]
    labels: IntArray  # [K] of the points that the part kept; -1 = in no cluster


def propose_clusters(
    cloud: PointCloud, settings: PartSettings, source: str, around: Surroundings
) -> Proposed:
    """Remove planes and outliers and number what is left, the largest first.

    Raises:
        UserError: nothing is left.
    """
    cleaning = settings.cleaning
    if cleaning is not None:
        cleaning = dataclasses.replace(cleaning, seed_point=None, clusters=0)
    wanted = PartSettings(settings.boxes, cleaning)
    part = make_part(cloud, wanted, source, around)
    kept = part.cloud.select(np.flatnonzero(part.reason < 0))
    spacing = median_spacing(cloud.points, 20_000)
    eye = None if around.viewpoint is None else np.asarray(around.viewpoint)
    up = None if around.up is None else np.asarray(around.up)
    labels = segment(kept.points, kept.colors, spacing, VOTES[1], viewpoint=eye, up=up)
    sizes = np.bincount(labels)
    least = max(_FEWEST_POINTS, round(_LEAST_SHARE * len(kept)))
    number = min(int((sizes >= least).sum()), _MOST_CLUSTERS)
    labels = np.where(labels < number, labels, -1)
    margin = _MARGIN_SPACINGS * spacing
    clusters = tuple(_described(kept.points[labels == k], margin) for k in range(number))
    return Proposed(part, clusters, labels)


def _described(points: Float64Array, margin: float) -> ProposedCluster:
    """Return a cluster's seed point and box."""
    middle = np.median(points, axis=0)
    seed = points[int(np.square(points - middle).sum(axis=1).argmin())]
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    sx, sy, sz = seed.tolist()
    cx, cy, cz = ((low + high) / 2).tolist()
    hx, hy, hz = ((high - low) / 2).tolist()
    return ProposedCluster(len(points), (sx, sy, sz), (cx, cy, cz, hx, hy, hz))


def cluster_sheet(found: Proposed, up: UpAxis, name: str, size_px: int = 480) -> Image.Image:
    """Draw the scan with its clusters in colours, numbered, from above and from two sides."""
    part = found.part
    reach, _ = thin_to_count(part.cloud.points, _MOST_DRAWN)
    label = np.full(len(part.cloud), -1)
    label[part.reason < 0] = found.labels
    cloud, label = part.cloud.select(np.flatnonzero(reach)), label[reach]
    middle = (cloud.points.min(axis=0) + cloud.points.max(axis=0)) / 2
    splats = points_to_splats(cloud.points - middle, cloud.colors)
    tinted = splats.base_colors.clone()
    own = torch.from_numpy(_PALETTE[label[label >= 0] % len(_PALETTE)] / 255.0).float()
    where = torch.from_numpy(label >= 0)
    tinted[where] = 0.35 * tinted[where] + 0.65 * own
    splats = dataclasses.replace(splats, sh=colors_to_sh(tinted))
    frame = ObjectFrame.about(splats, up)
    shown = transform_splats(splats, frame.object_from_file)
    pictures = [
        _drawn(found, shown, frame, middle, camera)
        for camera in (
            ViewDistribution(azimuth, elevation, radius=1.9).input_camera(size_px)
            for azimuth, elevation in ((270.0, 89.0), (270.0, 35.0), (0.0, 35.0))
        )
    ]
    columns = ["from above", "azimuth 270", "azimuth 0"]
    return contact_sheet([pictures], column_labels=columns, title=f"{name}: numbered clusters")


def _drawn(
    found: Proposed,
    shown: Splats,
    frame: ObjectFrame,
    middle: Float64Array,  # [3] taken from the source's coordinates
    camera: Cameras,
) -> Image.Image:
    """Draw one picture with numbers and the source's axes."""
    camera = camera.to(dtype=torch.float32)
    with torch.no_grad():
        picture = to_image(render(shown, camera, torch.tensor(LIGHT_GREY)).color[0])
    draw = ImageDraw.Draw(picture)

    def pixel(point: Float64Array) -> tuple[float, float]:  # [3] source's frame
        local = frame.object_from_file.apply(torch.from_numpy(point - middle))
        pose = camera.camera_from_world[0].double()
        x, y, z = (pose[:3, :3] @ local + pose[:3, 3]).tolist()
        fx, fy = camera.focal_px[0].tolist()
        cx, cy = camera.center_px[0].tolist()
        return fx * x / max(z, 1e-6) + cx, fy * y / max(z, 1e-6) + cy

    corner = found.part.cloud.points.min(axis=0)
    extent = found.part.cloud.points.max(axis=0) - corner
    unit = 10.0 ** np.floor(np.log10(max(float(extent.max()), 1e-12)))
    step = unit * next(t for t in _TICKS if 6 * t * unit >= extent.max() or t == _TICKS[-1])
    for axis, color in enumerate(_AXIS_COLORS):
        direction = np.eye(3)[axis]
        draw.line([*pixel(corner), *pixel(corner + extent[axis] * direction)], color, 2)
        first = np.ceil(corner[axis] / step)
        for tick in np.arange(first, np.floor((corner + extent)[axis] / step) + 1):
            place = corner + (tick * step - corner[axis]) * direction
            x, y = pixel(place)
            draw.ellipse((x - 2, y - 2, x + 2, y + 2), fill=color)
            draw.text((x + 4, y - 5), f"{'xyz'[axis]} {tick * step:.4g}", color)
    for number, cluster in enumerate(found.clusters, 1):
        x, y = pixel(np.array(cluster.seed))
        text = str(number)
        wide = 5 + draw.textlength(text) / 2
        draw.ellipse((x - wide, y - 9, x + wide, y + 9), fill=(255, 255, 255), outline=(0, 0, 0))
        draw.text((x - wide + 5, y - 6), text, (0, 0, 0))
    return picture
