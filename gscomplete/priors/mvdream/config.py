"""What an MVDream model is made of: sizes of its three networks, read from where they are stated.

Conventions
-----------
* Defaults are the published model, sd-v2.1-base-4view (Shi et al. 2023): 867,572,164 + 83,653,863
  parameters and the OpenCLIP ViT-H text tower.
* Field names are those of the original configuration where it has the field.
* Nothing else fixes a size: every module builds itself from these values.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from gscomplete.errors import UserError
from gscomplete.priors.latent.networks import TextConfig, VAEConfig
from gscomplete.util.jsonio import from_json

_NO_SIZES = ("image_size", "use_checkpoint", "use_fp16")
"""Fields of original configurations that do not change the network."""
_ONLY: dict[str, Any] = {
    "use_spatial_transformer": True,
    "use_linear_in_transformer": True,
    "legacy": False,
    "dims": 2,
    "dropout": 0,
    "num_heads": -1,
    "ip_dim": 0,
    "ip_mode": None,
}
"""Fields with the one value that this network has; another one is another model (ImageDream has
``ip_dim``, sd-v1.5-4view ``num_heads``)."""


@dataclass(frozen=True, slots=True)
class UNetConfig:
    """The denoiser: SD 2.1's UNet with a camera embedding and self-attention across views."""

    in_channels: int = 4
    out_channels: int = 4
    model_channels: int = 320
    channel_mult: tuple[int, ...] = (1, 2, 4, 4)
    """Width of each level in multiples of ``model_channels``."""
    num_res_blocks: int = 2
    """Residual blocks per level on the way down; one more on the way up."""
    attention_resolutions: tuple[int, ...] = (4, 2, 1)
    """Downsampling factors at which levels have attention; the middle always has."""
    num_head_channels: int = 64
    """Channels per attention head."""
    transformer_depth: int = 1
    context_dim: int = 1024
    """Width of the text embedding."""
    camera_dim: int = 16
    num_views: int = 4
    """Consecutive images of a batch that attend to each other."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each level."""
        return tuple(self.model_channels * factor for factor in self.channel_mult)

    @property
    def has_attention(self) -> tuple[bool, ...]:
        """Whether each level has attention."""
        return tuple(2**level in self.attention_resolutions for level in range(len(self.widths)))

    def __post_init__(self) -> None:
        """Check that widths divide.

        Raises:
            ValueError: a size is not positive, or a level's width is not a multiple of 32 (its
                norms' groups) or of a head.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            if not numbers or min(numbers) < 1:
                raise ValueError(f"{field.name}: expected positive sizes, found {value}")
        for width in self.widths:
            if width % 32 or width % self.num_head_channels:
                raise ValueError(
                    f"channel_mult: expected widths divisible by 32 and by num_head_channels "
                    f"({self.num_head_channels}), found {width}"
                )

    @classmethod
    def from_original(cls, data: Any, source: str) -> UNetConfig:
        """Read the original's UNet parameters, as in its YAML or in ``unet/config.json``.

        Args:
            data: parsed mapping; fields left out take the published values.
            source: the file named in errors.

        Raises:
            UserError: a field is wrong, or belongs to another model (ImageDream, SDXL...).
        """
        if not isinstance(data, dict):
            raise UserError(f"{source}: expected an object with the UNet's sizes")
        kept = {k: v for k, v in data.items() if not k.startswith("_") and k not in _NO_SIZES}
        for name, value in _ONLY.items():
            found = kept.pop(name, value)
            if found != value:
                raise UserError(
                    f"{source}: {name}: expected {value} as in MVDream (sd-v2.1-base-4view), "
                    f"found {found}"
                )
        return from_json(cls, {**_as_json(cls()), **kept}, source)


@dataclass(frozen=True, slots=True)
class MVDreamConfig:
    """All three networks."""

    unet: UNetConfig = dataclasses.field(default_factory=UNetConfig)
    vae: VAEConfig = dataclasses.field(default_factory=VAEConfig)
    text: TextConfig = dataclasses.field(default_factory=TextConfig)

    def __post_init__(self) -> None:
        """Check that the networks fit together.

        Raises:
            ValueError: the text is not as wide as the UNet expects.
        """
        if self.text.width != self.unet.context_dim:
            raise ValueError(
                f"unet.context_dim: expected the text tower's width {self.text.width}, found "
                f"{self.unet.context_dim}"
            )


PUBLISHED = MVDreamConfig()
"""sd-v2.1-base-4view."""


def _as_json(config: UNetConfig) -> dict[str, Any]:
    values = dataclasses.asdict(config)
    return {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}
