"""Rows about cameras, image sizes, places and threads."""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import torch

from gscomplete.render import render
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution, orbit_cameras
from recipes.stress_numerics.rows import (
    Check,
    Row,
    against_twin,
    draw_and_differentiate,
    nonfinite,
)
from recipes.stress_numerics.scenes import front_camera, random_splats, ring, with_fields


def _camera_plane(quick: bool) -> Iterator[Check]:
    near = np.float32(0.01)
    levels = [-5.0, -1e-30, 0.0, 1e-30, float(near), float(np.nextafter(near, np.float32(1)))]
    depth = torch.tensor([*levels, 0.0101, 0.02, 0.05, 1.0]).repeat(6)
    base = random_splats(60, 20, scale=0.01)
    means = torch.cat([base.means[:, :2] * depth.abs()[:, None], depth[:, None]], dim=1)
    yield from against_twin(with_fields(base, means=means), front_camera(48))
    large = torch.tensor([0.5, 0.3, 0.1])
    straddling = with_fields(base, means=means, scales=large, opacities=0.2)
    yield from against_twin(straddling, front_camera(48), label="through the camera: ")


def _image_edge(quick: bool) -> Iterator[Check]:
    camera = front_camera(40)
    base = random_splats(120, 21)
    edge = math.tan(math.radians(30.0))
    where = torch.tensor([-1.001, -1.0, -0.999, 0.999, 1.0, 1.001]).repeat(20)
    means = torch.stack([2 * edge * where, 2 * edge * where.roll(1), torch.full((120,), 2.0)], 1)
    yield from against_twin(with_fields(base, means=means), camera)
    outside = means * torch.tensor([30.0, 30.0, 1.0])
    wide = with_fields(base, means=outside, scales=torch.tensor([20.0, 10.0, 1.0]), opacities=0.3)
    yield from against_twin(wide, camera, label="far outside: ")


def _long_needles(quick: bool) -> Iterator[Check]:
    base = random_splats(40, 22)
    reach = 10.0 ** torch.linspace(0, 4, 40)
    means = torch.stack([reach, torch.zeros(40), torch.full((40,), 2.0)], dim=1)
    scales = torch.stack([reach, torch.full((40,), 1e-4), torch.full((40,), 1e-4)], dim=1)
    along_x = with_fields(
        base, means=means, scales=scales, quaternions=torch.tensor([1.0, 0.0, 0.0, 0.0])
    )
    half = math.radians(25.0)
    turn = torch.tensor([math.cos(half), 0.0, 0.0, math.sin(half)])
    c, s = math.cos(2 * half), math.sin(2 * half)
    tilted = means @ torch.tensor([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    camera = front_camera(64)
    yield from against_twin(along_x, camera, label="level: ")
    slanted = with_fields(along_x, means=tilted, quaternions=turn)
    # Screen positions are float32: a centre so far out is off by this many pixels, and a needle as
    # thin as the blur (0.55 pixels) shows it.
    shift_px = 2**-24 * float(camera.focal_px[0, 0]) * 1e4 / 2
    limits = {"color_limit": 2 * shift_px, "gradient_limit": 5 * shift_px}
    yield from against_twin(slanted, camera, label="slanted: ", **limits)


def _offset(quick: bool) -> Iterator[Check]:
    base = random_splats(300, 23)
    target = torch.full((3,), 1e6, dtype=torch.float64)
    cameras = orbit_cameras(
        torch.tensor([20.0, 110.0]),
        torch.tensor([15.0, -10.0]),
        radius=2.5,
        fov_deg=45.0,
        size_px=48,
        target=target,
    )
    there = with_fields(base, means=(base.means.double() + target).float())
    yield from against_twin(there, cameras)
    # Positions there are multiples of 1/16, and so is the camera's: this is how far that goes.
    rounding = math.sqrt(3) * (2**-5 + 2**-4)
    limit_px = rounding * float(cameras.focal_px[0, 0]) / 2.5
    at_origin = ring(48)[0]
    shift = _centroid(render(there, cameras[0]).alpha) - _centroid(render(base, at_origin).alpha)
    yield Check("shift of the picture (pixels)", float(shift.abs().max()), limit_px)


def _centroid(alpha: torch.Tensor) -> torch.Tensor:  # [1, H, W] -> [2]
    """Return the mean pixel of what is seen."""
    rows, columns = torch.meshgrid(*map(torch.arange, alpha.shape[1:]), indexing="ij")
    weight = alpha[0].detach() / alpha.detach().sum()
    return torch.stack([(weight * columns).sum(), (weight * rows).sum()])


def _fields_of_view(quick: bool) -> Iterator[Check]:
    for fov in (1.0, 5.0, 60.0, 120.0, 160.0, 170.0):
        radius = max(0.6 / math.tan(math.radians(fov) / 2), 0.3)
        cameras = ring(40, fov, radius)
        yield from against_twin(random_splats(150, 24), cameras, label=f"{fov:g} degrees: ")


def _image_sizes(quick: bool) -> Iterator[Check]:
    base = random_splats(100, 25)
    moved = with_fields(base, means=base.means + torch.tensor([0.0, 0.0, 2.0]))
    for width, height in ((1, 1), (1, 33), (33, 1), (7, 9), (4096, 8), (8, 4096)):
        camera = front_camera(width, height)
        yield from against_twin(moved, camera, label=f"{width} x {height}: ")
    size = 1024 if quick else 4096
    picture, grads = draw_and_differentiate(moved, front_camera(size), "cpu")
    broken = nonfinite(picture.color, picture.depth, *grads.values())
    yield Check(f"{size} x {size}: non-finite values", broken, 0)
    small = render(moved, front_camera(size // 8)).alpha.sum()
    ratio = float(picture.alpha.detach().sum() / 64 / small)
    yield Check(f"{size} x {size}: area against a small picture", abs(ratio - 1), 0.1)


def _threads(quick: bool) -> Iterator[Check]:
    digests = []
    for threads in (1, 2):
        environment = {**os.environ, "NUMBA_NUM_THREADS": str(threads)}
        command = [sys.executable, "-m", "recipes.stress_numerics.view_rows"]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
        digests.append(json.loads(done.stdout))
    yield Check("threads that were not used", abs(digests[1]["threads"] - 2), 0)
    names = digests[0]["bits"]
    for name in names:
        changed = digests[0]["bits"][name] != digests[1]["bits"][name]
        yield Check(f"{name}: bits changed", int(changed), 0)


def picture_digests() -> dict[str, str]:
    """Return a digest of the bits of a picture and of every gradient."""
    base = random_splats(4000, 26, degree=1)
    picture, grads = draw_and_differentiate(base, ring(128), "cpu")
    parts = {"color": picture.color, "alpha": picture.alpha, "depth": picture.depth, **grads}
    return {
        name: hashlib.sha256(value.detach().contiguous().numpy().tobytes()).hexdigest()
        for name, value in parts.items()
    }


def _similarities(quick: bool) -> Iterator[Check]:
    base = random_splats(200, 27, degree=2)
    angle = 0.7
    rotation = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]],
        dtype=torch.float64,
    )
    for scale in (1e-36, 1e-12, 1e-3, 1e3, 1e12, 1e30):
        there = Similarity(scale, rotation, torch.tensor([0.5, -1.0, 2.0]) * scale)
        back = transform_splats(transform_splats(base, there), there.inverse())
        for name, value in back.fields():
            old = getattr(base, name)
            error = float((value - old).abs().max() / old.abs().max())
            yield Check(f"scale {scale:g}: {name} there and back", error, 2e-6)
    # Numbers of 1e-43 have few bits, but splats that went there are not lost.
    tiny = Similarity(1e-41, rotation, torch.zeros(3))
    kept = transform_splats(transform_splats(base, tiny), tiny.inverse())
    yield Check("scale 1e-41: non-finite", nonfinite(*(v for _, v in kept.fields())), 0)
    yield Check("scale 1e-41: scales", float((kept.scales / base.scales - 1).abs().max()), 0.2)


def _view_distributions(quick: bool) -> Iterator[Check]:
    eye = torch.eye(3)
    for elevation in (-90.0, 90.0, 0.0):
        for azimuth_range, elevation_range in ((0.0, 0.0), (180.0, 90.0)):
            views = ViewDistribution(1e6, elevation, azimuth_range, elevation_range)
            cameras = [
                views.cameras(views.sample(2**63 + 5, 2**40, 64), 16),
                views.cameras(views.low_discrepancy(64), 16),
                views.ring(4, 16),
            ]
            label = f"elevation {elevation:g}, ranges {azimuth_range:g} and {elevation_range:g}"
            rotations = torch.cat([c.camera_from_world[:, :3, :3] for c in cameras])
            error = (rotations @ rotations.transpose(1, 2) - eye).abs().max()
            yield Check(f"{label}: rotations", float(error), 1e-6)
            again = ViewDistribution.from_json(json.loads(json.dumps(views.to_json())), "x")
            yield Check(f"{label}: JSON changed", int(again != views), 0)
    poles = orbit_cameras(
        torch.tensor([0.0, 90.0, 1e6]),
        torch.tensor([90.0, -90.0, 90.0]),
        radius=2.5,
        fov_deg=45.0,
        size_px=40,
    )
    yield from against_twin(random_splats(200, 28), poles, label="from the poles: ")


VIEW_ROWS = (
    Row("camera plane", "behind, on and just past near; sizes through the camera", _camera_plane),
    Row("image edge", "centres on the edge, and 30 images outside", _image_edge),
    Row("long needles", "lengths 1 to 1e4 from far outside across the image", _long_needles),
    Row("offset 1e6", "splats and camera moved by 1e6", _offset),
    Row("fields of view", "1 to 170 degrees", _fields_of_view),
    Row("image sizes", "1 x 1 to 4096 wide", _image_sizes),
    Row("threads", "1 and 2 threads, in processes of their own", _threads),
    Row("similarities", "scales 1e-41 to 1e30, there and back", _similarities),
    Row(
        "view distributions",
        "elevations +/-90, ranges 180 and 90, azimuth 1e6",
        _view_distributions,
    ),
)
"""Rows about views."""

if __name__ == "__main__":
    import numba

    render(random_splats(2, 0), ring(8))
    json.dump({"threads": numba.get_num_threads(), "bits": picture_digests()}, sys.stdout)
