"""All settings of the renderer, and the definition of the picture that all backends draw.

Definition (after Kerbl et al. 2023; all backends and the float64 twin follow it)
---------------------------------------------------------------------------------
A splat with camera-space centre (x, y, z), z > near, covers the pixel at p with
    alpha = min(alpha_max, opacity * exp(-0.5 (p - u)^T K (p - u)))
where u is the projected centre, K the inverse of J W Sigma W^T J^T + blur_px2 * I, and alphas below
``alpha_min`` count as zero. Splats are composited front to back in order of z (ties by index).
A backend may stop once the remaining transmittance is below ``transmittance_min``.
Splats with a value that is not finite, an opacity above 1, a depth or colour beyond ``MAX_VALUE``,
or a width beyond 1e35 pixels are not drawn (gsplat leaves out fewer of them).
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_VALUE = 1e30
"""Depths and colours of splats that are drawn are smaller, so that sums over them are finite."""


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """Constants of the image formation; the defaults are those of 3DGS as gsplat draws it."""

    near: float = 0.01
    """Splats with camera-space z at or below this are not drawn (world units)."""
    blur_px2: float = 0.3
    """Variance added to both screen axes (pixels squared), the 3DGS low-pass filter."""
    alpha_min: float = 1.0 / 255.0
    """A pixel's alpha below this is zero. At least 1e-5, so that tile lists stay finite."""
    alpha_max: float = 0.999
    """A pixel's alpha is clamped to this; clamped pixels pass no gradient to shape or opacity.
    0.999 is gsplat's value, so that both backends draw the same picture (original 3DGS: 0.99)."""
    transmittance_min: float = 1e-5
    """Compositing of a tile stops when every pixel's transmittance is below this; 0 = never. (At
    3DGS's 1e-4 gradients of opacities are off by 0.1 %.)"""
    exact_tile_lists: bool = True
    """CPU: list a splat in the tiles that its ellipse reaches; False = in all tiles of its pixel
    box, as 3DGS does: only slower, the picture moves by less than ``transmittance_min``."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ValueError: a value is outside the range its backend can draw.
        """
        if not 1e-5 <= self.alpha_min < self.alpha_max < 1.0:
            raise ValueError(
                "RenderSettings: expected 1e-5 <= alpha_min < alpha_max < 1, found "
                f"alpha_min={self.alpha_min}, alpha_max={self.alpha_max}"
            )
        if self.near <= 0 or self.blur_px2 <= 0 or not 0 <= self.transmittance_min < 1:
            raise ValueError(
                "RenderSettings: expected near > 0, blur_px2 > 0 and 0 <= transmittance_min < 1, "
                f"found {self.near}, {self.blur_px2}, {self.transmittance_min}"
            )
