"""Self-attention across the views of a group: what makes MVDream more than Stable Diffusion.

Conventions
-----------
* The views of a group are consecutive in the batch, view fastest; tokens of a group are
  concatenated view after view, attended together, and split again.
* Only self-attention (``attn1`` of every transformer block) is joint. Cross-attention, norms and
  feed-forward layers stay within a view. There is no code for the view's number: views are told
  apart by their cameras alone.
* Processors are not part of saved weights, so a model without them loads and runs, and is plain
  Stable Diffusion; :func:`check_joint_attention` is called wherever a model is put to use.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor


class JointAttention:
    """An attention processor of diffusers that attends over all views of a group."""

    def __init__(self, num_views: int, stock: Any) -> None:
        """Wrap the stock processor.

        Args:
            num_views: images per group.
            stock: diffusers' scaled-dot-product processor, which does the attending.
        """
        self.num_views = num_views
        self._stock = stock

    def __call__(
        self,
        attn: Any,
        hidden_states: Tensor,  # [groups * num_views, tokens, width]
        encoder_hidden_states: Tensor | None = None,
        attention_mask: Tensor | None = None,
        temb: Tensor | None = None,
    ) -> Tensor:  # [groups * num_views, tokens, width]
        """Attend over the tokens of each group.

        Raises:
            ValueError: the batch is not whole groups, or this is not self-attention.
        """
        batch, tokens, width = hidden_states.shape
        if batch % self.num_views or encoder_hidden_states is not None:
            raise ValueError(
                f"JointAttention: expected self-attention over groups of {self.num_views} images, "
                f"found a batch of {batch}"
            )
        groups = hidden_states.reshape(batch // self.num_views, self.num_views * tokens, width)
        joined = self._stock(attn, groups, None, attention_mask, temb)
        return joined.reshape(batch, tokens, width)


def install_joint_attention(unet: Any, num_views: int) -> None:
    """Give every self-attention of a UNet the joint processor and every other one the stock one."""
    from diffusers.models.attention_processor import AttnProcessor2_0

    unet.set_attn_processor(
        {
            name: JointAttention(num_views, AttnProcessor2_0())
            if name.endswith("attn1.processor")
            else AttnProcessor2_0()
            for name in unet.attn_processors
        }
    )


def check_joint_attention(unet: Any, num_views: int) -> int:
    """Return how many self-attentions are joint (16 in the published model).

    Raises:
        RuntimeError: one of them is not, or spans another number of views: the model would be
            Stable Diffusion's without a sign of it.
    """
    selfs = {k: v for k, v in unet.attn_processors.items() if k.endswith("attn1.processor")}
    for name, processor in selfs.items():
        if not (isinstance(processor, JointAttention) and processor.num_views == num_views):
            raise RuntimeError(f"{name}: expected joint attention over {num_views} views")
    if not selfs:
        raise RuntimeError("expected self-attention in the UNet, found none")
    return len(selfs)
