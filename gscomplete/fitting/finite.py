"""Stop an optimisation before a value that float32 cannot square reaches splats or a checkpoint."""

from __future__ import annotations

from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.splats.filters import MAX_MAGNITUDE


class NonFiniteError(UserError):
    """A tensor of a run stopped being finite; the last checkpoint is still good."""

    exit_code = 3

    def __init__(self, step: int, tensor: str, advice: str = "") -> None:
        """Say at which step, and which tensor."""
        message = f"step {step}: {tensor} is not finite, or too large for float32; the run stops"
        super().__init__(message + advice)
        self.step, self.tensor = step, tensor


def require_finite(step: int, **tensors: Tensor | None) -> None:
    """Refuse tensors that are not finite or too large.

    Adam squares gradients: above ``MAX_MAGNITUDE`` its moment would be infinite, and the splat
    would silently stand still from then on.

    Raises:
        NonFiniteError: a tensor is not finite or too large; the first one is named.
    """
    for name, tensor in tensors.items():
        if tensor is not None and not bool((tensor.detach().abs() < MAX_MAGNITUDE).all()):
            raise NonFiniteError(step, name)
