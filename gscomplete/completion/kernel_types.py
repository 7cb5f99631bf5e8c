"""The kernels of a completion that a second process compiles during the first run.

These are the kernels that are called late or take longest to compile; ``util.kernels`` tells how.
"""

from __future__ import annotations

from gscomplete.util.kernels import KernelTypes

COMPILED_BESIDE: tuple[KernelTypes, ...] = (
    KernelTypes(
        "gscomplete.render.cpu.tiles",
        "count_entries",
        "(i8, i8, f4[:, ::1], i4[::1], i8, i8, i8, b1, i4[:, ::1], i4[:, ::1], i8[::1])",
    ),
    KernelTypes(
        "gscomplete.render.cpu.composite",
        "composite",
        "(i8, i8, f4[:, ::1], f4[:, ::1], i8[::1], i4[::1], i4[::1], i8[::1], i8, f4, f4, f4, "
        "f4[:, :, ::1], f4[:, ::1], f4[:, ::1], i4[::1], u1[::1])",
    ),
    KernelTypes(
        "gscomplete.shape.planes.features",
        "count_samples",
        "(f4[:, ::1], f4[:, ::1], f4[:, ::1], u1[:, :, ::1], f4[:, :, :, ::1], f4[:, :, :, ::1], "
        "f4[:, :, ::1], f4[:, :, ::1], f8, f4[:, ::1], f4[::1], f4[:, :, ::1])",
    ),
    KernelTypes(
        "gscomplete.shape.planes.fine_scorer",
        "spread_cells",
        "(f4[:, ::1], f4[::1], f4[::1], i8, i8, i8, f4[:, :, :, ::1])",
    ),
    KernelTypes(
        "gscomplete.networks.byte_convolution",
        "norm_lines",
        "(i8, i8, f4[:, :, ::1], f4[::1], f4[::1], f4[:, ::1], f4[:, ::1], i8, f8, f4[:, ::1], "
        "f4[:, ::1], f8[::1])",
    ),
    KernelTypes(
        "gscomplete.networks.byte_convolution",
        "silu_bytes",
        "(i8, i8, f4[:, ::1], i8, f4[:, ::1], f4[:, ::1], f4, f4, u1[:, ::1])",
    ),
    KernelTypes(
        "gscomplete.splats.geometry.poisson_disk",
        "keep_apart",
        "(f8[:, ::1], f8[:, ::1], f8)",
    ),
    KernelTypes("gscomplete.render.cpu.merge", "count_in_front", "(u8[::1], u8[::1])"),
    KernelTypes(
        "gscomplete.render.cpu.merge",
        "join_entries",
        "(i8, i8, i4[::1], i4[::1], i8, i8[::1], i4[::1], i4[::1], i4[::1], i4[::1], i8[::1], "
        "i4[::1], i4[::1])",
    ),
)
"""In the order of use."""
