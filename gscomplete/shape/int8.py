"""The shape network with 8-bit convolutions, for processors that multiply bytes in hardware.

The convolutions of the residual blocks and the last convolution run in 8 bits
(``networks.byte_convolution``); everything else runs in bfloat16 under autocast, or in float32.
"""

from __future__ import annotations

from torch import Tensor, nn

from gscomplete.networks.byte_convolution import ByteConvolution, normalised_silu
from gscomplete.shape.network import Level, ResidualBlock, ShapeCompleter, laid_out


class ByteBlock(nn.Module):
    """A residual block whose convolutions run in 8 bits."""

    def __init__(self, block: ResidualBlock) -> None:
        super().__init__()
        self.norm_in, self.norm_out = block.norm_in, block.norm_out
        self.modulation = block.modulation
        self._conv_in = ByteConvolution(block.conv_in)
        self._conv_out = ByteConvolution(block.conv_out)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:  # [B, C, n, n, n], [B, E]
        """Return the features after the block, float32."""
        x = x.float()
        scale, shift = self.modulation(embedding).float().chunk(2, dim=1)
        h = self._conv_in(*normalised_silu(x, self.norm_in))
        h = self._conv_out(*normalised_silu(h, self.norm_out, (1 + scale, shift.contiguous())))
        return h.add_(x)


class ByteShapeCompleter(ShapeCompleter):
    """A shape network in 8 bits, for inference only: gradients have to be off."""

    def __init__(self, given: ShapeCompleter) -> None:
        """Share all layers that stay in floating point with ``given``, which is not changed."""
        nn.Module.__init__(self)
        self.config = given.config
        for name, part in given.named_children():
            self.add_module(name, part)
        self.down, self.up = _in_bytes(given.down), _in_bytes(given.up)
        self._head = ByteConvolution(given.head)
        laid_out(self.eval())

    def answer_of(self, x: Tensor) -> Tensor:  # [B, C, n, n, n] -> [B, O, n, n, n]
        """Return what the last features say, float32."""
        return self._head(*normalised_silu(x.float(), self.norm))


def _in_bytes(levels: nn.ModuleList) -> nn.ModuleList:
    """Return levels whose blocks run in 8 bits."""
    found = nn.ModuleList()
    for level in levels:
        assert isinstance(level, Level)
        found.append(Level(ByteBlock(b) for b in level if isinstance(b, ResidualBlock)))
    return found
