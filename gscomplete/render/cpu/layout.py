"""What the CPU kernels pass to each other: packed rows, gradient sums and the camera vector.

Conventions
-----------
* ``camera`` is a tuple of float64: the 3x4 rows of camera_from_world (12 numbers), then
  fx, fy, cx, cy, width, height, near, blur_px2, alpha_min. It is a tuple because a kernel's stores
  cannot change it; the compiler would read the numbers of an array again after every store.
* A projected splat is one row of PACKED float32 values (the ``P_*`` columns): screen centre (u, v),
  whitening L = [[LA, LB], [0, LC]], opacity, colour, depth, and the half height and width of its
  pixel box at alpha_min. L^T L is the inverse screen covariance, so with the whitened offset
  w = L (p - u) the exponent is -|w|^2 / 2, and only p - u cancels: u and v are float32, so a thin
  needle far longer than the image has the wrong alpha by up to 1.8e-4 at a length of 6.4e3 pixels
  and 1.8e-3 at 6.4e4 (centre off the image, slanted across it).
"""

P_U, P_V, P_LA, P_LB, P_LC, P_OPACITY = range(6)
P_RED, P_GREEN, P_BLUE, P_DEPTH, P_HALF_H, P_HALF_W = range(6, 12)
PACKED = 12
S_POWER, S_X, S_Y, S_XX, S_XY, S_YY, S_RED, S_GREEN, S_BLUE, S_DEPTH = range(10)
SUMS = 10
"""Columns of the per-tile gradient sums that ``composite`` writes: sums over pixels of
dL/dpower times 1, wx, wy, wx^2, wx wy, wy^2 (w: whitened offset), and of the colour and depth
gradients."""

EDGE_SLACK = 0.15
"""The Jacobian is taken at most this share of the image size outside the image, as in 3DGS."""
MAX_VARIANCE_PX2 = 1e70
"""Splats whose screen variance along x or y is larger are not drawn: all that is kept of the others
are normal float32 numbers."""
