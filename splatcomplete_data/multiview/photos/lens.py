"""Lenses: how a camera's photo differs from a pinhole image, and how to undo it.

Conventions
-----------
* Normalised coordinates (x, y) = (X / Z, Y / Z) in OpenCV camera axes; pixels have their centres
  at +0.5, as COLMAP counts them.
* ``brown``: OpenCV's radial (k1 to k6, rational) and tangential (p1, p2) distortion.
  ``fisheye``: OpenCV's equidistant model, theta (1 + k1 theta^2 + ... + k4 theta^8).
* The undistorted image has the lens's own focal lengths, principal point and size. Its pixels that
  no photo pixel shows are marked, not cropped away, so one camera describes photo and image.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import BoolArray, Float64Array

LensKind = Literal["brown", "fisheye"]
"""``brown``: radial and tangential; ``fisheye``: equidistant."""

_FOLD_STEPS = 4096


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics and distortion of one camera."""

    width: int
    height: int
    focal_px: tuple[float, float]  # fx, fy
    center_px: tuple[float, float]  # cx, cy
    kind: LensKind = "brown"
    radial: tuple[float, float, float, float, float, float] = (0.0,) * 6  # k1 .. k6
    tangential: tuple[float, float] = (0.0, 0.0)  # p1, p2

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: a size or focal length is not positive, or a number is not finite.
        """
        numbers = (*self.focal_px, *self.center_px, *self.radial, *self.tangential)
        if self.width < 1 or self.height < 1:
            raise ValueError(f"size: expected positive pixels, found {self.width} x {self.height}")
        if not np.isfinite(numbers).all():
            raise ValueError(f"lens: expected finite numbers, found {numbers}")
        if min(self.focal_px) <= 0:
            raise ValueError(f"focal length: expected positive pixels, found {self.focal_px}")

    @property
    def is_pinhole(self) -> bool:
        """Whether photos need no undistortion."""
        return self.kind == "brown" and not any((*self.radial, *self.tangential))

    def resized(self, width: int, height: int) -> Lens:
        """Return the same lens for photos scaled to another size."""
        factor_x, factor_y = width / self.width, height / self.height
        return dataclasses.replace(
            self,
            width=width,
            height=height,
            focal_px=(self.focal_px[0] * factor_x, self.focal_px[1] * factor_y),
            center_px=(self.center_px[0] * factor_x, self.center_px[1] * factor_y),
        )

    def distort(
        self,
        x: Float64Array,  # any shape, normalised
        y: Float64Array,
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normalised coordinates at which the lens shows (x, y)."""
        k1, k2, k3, k4, k5, k6 = self.radial
        if self.kind == "fisheye":
            r = np.hypot(x, y)
            factor = _fisheye_radius(np.arctan(r), self.radial) / np.maximum(r, 1e-12)
            factor = np.where(r > 1e-9, factor, 1.0)
            return x * factor, y * factor
        p1, p2 = self.tangential
        r2 = x * x + y * y
        factor = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        factor = factor / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        shift_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        shift_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return x * factor + shift_x, y * factor + shift_y

    def fold_radius(self) -> float:
        """Return the normalised radius beyond which the radial distortion turns back.

        Polynomials fitted inside the picture fold over outside of it: without this limit a pixel
        far off the photo would show a second copy of its inside.
        """
        corner_x = max(self.center_px[0], self.width - self.center_px[0]) / self.focal_px[0]
        corner_y = max(self.center_px[1], self.height - self.center_px[1]) / self.focal_px[1]
        radius = np.linspace(0.0, 1.5 * float(np.hypot(corner_x, corner_y)), _FOLD_STEPS)
        straight = Lens(self.width, self.height, (1, 1), (0, 0), self.kind, self.radial)
        shown, _ = straight.distort(radius, np.zeros_like(radius))
        falling = np.flatnonzero(~(np.diff(shown) > 0))
        return float(radius[falling[0]]) if len(falling) else float("inf")


def _fisheye_radius(theta: Float64Array, radial: tuple[float, ...]) -> Float64Array:
    """Return the distorted radius of the equidistant model."""
    k1, k2, k3, k4 = radial[:4]
    t2 = theta * theta
    return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


@dataclass(frozen=True, slots=True)
class SourceMap:
    """Where the pixels of an undistorted photo are in the photo as it was taken."""

    lens: Lens
    x: Float64Array  # [H, W] columns, 0 at the centre of the first pixel
    y: Float64Array  # [H, W] rows
    inside: BoolArray  # [H, W] those that the photo shows

    @staticmethod
    def of(lens: Lens) -> SourceMap:
        """Distort the centres of all pixels; those of a pinhole stay, and are not listed."""
        if lens.is_pinhole:
            nothing = np.empty((0, 0))
            return SourceMap(lens, nothing, nothing, np.ones((lens.height, lens.width), np.bool_))
        column, row = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
        x = (column - lens.center_px[0]) / lens.focal_px[0]
        y = (row - lens.center_px[1]) / lens.focal_px[1]
        shown_x, shown_y = lens.distort(x, y)
        source_x = shown_x * lens.focal_px[0] + lens.center_px[0] - 0.5
        source_y = shown_y * lens.focal_px[1] + lens.center_px[1] - 0.5
        inside = (source_x >= 0) & (source_x <= lens.width - 1) & (source_y >= 0)
        inside &= (source_y <= lens.height - 1) & (np.hypot(x, y) < lens.fold_radius())
        return SourceMap(lens, source_x, source_y, inside)


def undistort(
    photo: NDArray[np.uint8],  # [H, W, C]
    source: SourceMap,
) -> tuple[NDArray[np.uint8], BoolArray]:  # [H, W, C], [H, W]
    """Resample a photo as a pinhole camera would have taken it.

    Returns:
        The image, and which of its pixels the photo shows; the others are black.

    Raises:
        ValueError: the photo's size is not the lens's.
    """
    height, width = photo.shape[:2]
    if (width, height) != (source.lens.width, source.lens.height):
        raise ValueError(
            f"photo {width} x {height}, lens {source.lens.width} x {source.lens.height}"
        )
    if source.lens.is_pinhole:
        return photo, source.inside
    image = np.zeros_like(photo)
    _sample(np.ascontiguousarray(photo), source.x, source.y, source.inside, image)
    return image, source.inside


@numba.njit(parallel=True, cache=True)
def _sample(photo: Any, source_x: Any, source_y: Any, inside: Any, image: Any) -> None:
    """Fill the inside pixels of ``image`` bilinearly from ``photo``."""
    height, width, channels = photo.shape
    for row in numba.prange(image.shape[0]):
        for column in range(image.shape[1]):
            if not inside[row, column]:
                continue
            x, y = source_x[row, column], source_y[row, column]
            left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
            right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
            wx, wy = x - left, y - top
            for c in range(channels):
                upper = (1 - wx) * photo[top, left, c] + wx * photo[top, right, c]
                lower = (1 - wx) * photo[bottom, left, c] + wx * photo[bottom, right, c]
                image[row, column, c] = np.uint8((1 - wy) * upper + wy * lower + 0.5)
