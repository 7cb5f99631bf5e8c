"""The embedded prior behind the common interface: a denoiser that can see P.

Conventions
-----------
* Images inside are those of ``inputs``: premultiplied RGBA in [-1, 1] at the model's resolution,
  so the loss of :meth:`EmbeddedPrior.distill` counts differences on that scale.
* P may be withheld (text-only mode), and a known shape of the noun shown instead
  (``conditioning``); guidance pulls towards P and towards the text with separate scales
  (``diffusion.guided_x0``).
* Networks run in 8 bits (``int8``), the rest of them in bfloat16, where the processor multiplies
  these in hardware, else in float32; schedules and losses are always float32.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.framing.cut_plane import find_cut
from gscomplete.networks.precision import Precision, is_bfloat16, is_in_bytes
from gscomplete.priors.base import Conditioning, FirstGuess, FourViews, Guidance, PriorViews
from gscomplete.priors.ddim import ddim, even_times
from gscomplete.priors.embedded.conditioning import EmbeddedConditioning, about_partial
from gscomplete.priors.embedded.diffusion import NUM_TIMESTEPS, add_noise, scales_like
from gscomplete.priors.embedded.elongated import shortening_of
from gscomplete.priors.embedded.ending import ending_of, ends_in_plane, mirror_of_half
from gscomplete.priors.embedded.inputs import images_to_color_alpha, network_images
from gscomplete.priors.embedded.int8 import in_bytes
from gscomplete.priors.embedded.model import VIEWS, FourViewDenoiser
from gscomplete.priors.embedded.ring_task import RingTask, ring_task
from gscomplete.priors.embedded.text import Tokenizer, understood_by
from gscomplete.priors.embedded.weights import (
    PriorConfig,
    packaged_weights,
    read_weights,
    weights_digest,
)
from gscomplete.shape.assemble import image_of_half, mirror_plane_of
from gscomplete.shape.bank.known import KnownShapes
from gscomplete.shape.bank.store import BANK_FILE
from gscomplete.shape.guess import NetworkContext, guess_complete
from gscomplete.shape.int8 import ByteShapeCompleter
from gscomplete.shape.mirror_plane import ChosenMirror, HalfCut, MirrorWish
from gscomplete.shape.network import ShapeCompleter, laid_out
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.symmetry_choice import score_planes
from gscomplete.splats import Splats
from gscomplete.splats.geometry.neighbourhood import flat_axes
from gscomplete.util.same_bits import fixed_sum
from gscomplete.views import ViewDistribution

DEFAULT_GUIDANCE = Guidance(text_scale=1.0, input_scale=1.0, rescale=0.0)
"""With P in sight plain conditional denoising is best; it takes a single pass."""
TEXT_ONLY_GUIDANCE = Guidance(text_scale=3.0, input_scale=1.0, rescale=0.5)
"""Without P the text needs a larger weight."""


@dataclass(frozen=True, slots=True)
class EmbeddedIdentity:
    """Everything about the prior that decides a run's result."""

    weights: str
    """Digest of the files."""


class EmbeddedPrior:
    """A :class:`gscomplete.priors.base.Prior` with the weights that ship with the package."""

    name = "embedded"
    sees_input = True
    presets: ClassVar[dict[str, str]] = {
        "default": "guess",
        "fast": "unbounded guess",
        "reconstruct": "reconstruct",
        "distill": "refine",
        "paper": "paper",
    }
    """Which settings of ``completion.presets`` a preset stands for with this prior."""
    num_timesteps = NUM_TIMESTEPS
    identity: EmbeddedIdentity | None = None
    """None = made from networks in memory."""

    def __init__(
        self,
        model: FourViewDenoiser | Callable[[], FourViewDenoiser],
        config: PriorConfig,
        device: torch.device | str = "cpu",
        precision: Precision = "auto",
        shape: ShapeCompleter | None = None,
        bank: Path | None = None,
    ) -> None:
        """Wrap a denoiser and a shape network.

        Args:
            model: in evaluation mode, or what makes it when it is first asked.
            config: what goes with it.
            device: where it runs.
            precision: of the networks. ``int8``: residual blocks in 8 bits on the CPU, the rest in
                bfloat16 if the CPU multiplies it in hardware. ``auto``: the fastest on this
                machine.
            shape: in evaluation mode; None = no first guess of the complete object.
            bank: file of known shapes; None = none is known.
        """
        self.views: PriorViews = config.views
        self._device = torch.device(device)
        self._given_model = model
        self._bank = bank
        self._tokenizer = Tokenizer(config.words, config.model.text_length)
        words = config.words if config.shape is None else config.shape.words
        self._shape_tokenizer = Tokenizer(words, config.model.text_length)
        self._bfloat16 = is_bfloat16(precision, self._device)
        on_cpu = torch.device("cpu")  # where the shape network is always: one pass of a second
        self._shape_bfloat16 = is_bfloat16(precision, on_cpu)
        in_8_bits = is_in_bytes(precision)
        self._int8 = in_8_bits and self._device.type == "cpu"
        self._shape = shape
        if shape is not None and in_8_bits:
            self._shape = ByteShapeCompleter(shape)
        elif shape is not None:
            laid_out(shape)
        if self._device.type != "cpu":
            _ = self._model  # a device that cannot be used is told before anything else is done

    @classmethod
    def from_folder(cls, folder: Path, device: torch.device | str = "cpu") -> EmbeddedPrior:
        """Load weights from a folder.

        Raises:
            UserError: the weights are missing or damaged.
        """
        stored = read_weights(folder)
        bank = next((f for f in (folder, packaged_weights()) if (f / BANK_FILE).is_file()), None)
        prior = cls(
            stored.denoiser,
            stored.config,
            device,
            shape=stored.shape(),
            bank=None if bank is None else bank / BANK_FILE,
        )
        prior.identity = EmbeddedIdentity(weights_digest(folder))
        return prior

    @functools.cached_property
    def _model(self) -> FourViewDenoiser:
        """The denoiser on its device; a default completion never asks it."""
        given = self._given_model
        model = given if isinstance(given, FourViewDenoiser) else given()
        if self._int8:
            return in_bytes(copy.deepcopy(model), bfloat16=self._bfloat16)
        return model.to(self._device)

    def default_guidance(self, *, sees_input: bool) -> Guidance:
        """Return the scales for P in sight or withheld; see :class:`base.Prior`."""
        return DEFAULT_GUIDANCE if sees_input else TEXT_ONLY_GUIDANCE

    def condition(self, prompt: str, negative_prompt: str | None = None) -> EmbeddedConditioning:
        """Encode a prompt; see :class:`gscomplete.priors.base.Prior`."""
        tokenizers = self._tokenizer, self._shape_tokenizer
        report = understood_by(tokenizers, prompt).lines()
        if negative_prompt:
            lines = self._tokenizer.understood(negative_prompt).lines()
            report += tuple(f"negative {line}" for line in lines)
        return EmbeddedConditioning(
            self._tokenizer.encode(prompt),
            self._tokenizer.encode(negative_prompt or ""),
            self._shape_tokenizer.encode(prompt),
            report,
            prompt,
        )

    def first_guess(
        self,
        partial: Splats,
        distribution: ViewDistribution,
        conditioning: Conditioning,
        generator: torch.Generator,
        count: int,
        mirror: MirrorWish = "guess",
        *,
        known_shapes: bool = True,
        prompt_decides: bool = False,
        captured: bool = False,
    ) -> FirstGuess | None:
        """Return the complete object as the shape network sees it; see :class:`base.ShapePrior`."""
        if self._shape is None:
            return None
        assert isinstance(conditioning, EmbeddedConditioning)
        if isinstance(mirror, HalfCut):
            cut = find_cut(partial.means.double().numpy(), flat_axes(partial))
            plane = mirror_of_half(partial, cut, mirror)
            if plane is None:
                raise UserError(
                    "--mirror cut: expected P to end at a plane near the frame's centre, found none"
                )
            image = image_of_half(partial, plane, distribution, generator)
            return FirstGuess(
                image, (f"P is one half: mirrored through the plane that it ends at, {plane}",)
            )
        ending = ending_of(partial, mirror)
        bank = self._bank if known_shapes else None
        known = KnownShapes(bank, conditioning.prompt, prompt_decides)
        if ending.is_complete and not (prompt_decides and known.fitted(partial, distribution)):
            nothing = partial.with_sh_degree(0).select(torch.arange(0))
            told = known.notes(()) if prompt_decides else ()
            return FirstGuess(nothing, told + ending.notes)
        context = self.context(conditioning, ends_in_plane=ending.in_plane, captured=captured)
        assert context is not None
        is_cut = ending.image_is_all
        if not is_cut and not prompt_decides:
            points = partial.means.double().numpy()
            long = shortening_of(points, ends_in_plane=ending.in_plane)
            through = None if long is None else long.mirror(ending.mirror)
            if long is not None and through is not None:
                there = long.splats(partial), long.views(distribution), through
                guess = guess_complete(
                    context, *there, KnownShapes(None, conditioning.prompt), count, generator,
                    of_ending=ending.features, plane_back=long.plane_back,
                )  # fmt: skip
                told = (long.note, *ending.notes, *guess.notes)
                return FirstGuess(long.splats_back(guess.splats), told)
        about = partial, distribution, ending.mirror, known, count, generator
        guess = guess_complete(context, *about, mirror_is_cut=is_cut, of_ending=ending.features)
        notes = ending.notes if guess.heeds_cut and not ending.is_complete else ()
        return FirstGuess(guess.splats, notes + guess.notes)

    def context(
        self, conditioning: Conditioning, *, ends_in_plane: bool, captured: bool = False
    ) -> NetworkContext | None:
        """Return the shape network and how it is asked about a part; None = there is none.

        Args:
            conditioning: of the prompt.
            ends_in_plane: whether P was cut along a plane, as far as found.
            captured: whether P was trained from photos and nothing was cut off it.
        """
        if self._shape is None:
            return None
        assert isinstance(conditioning, EmbeddedConditioning)
        return NetworkContext(
            self._shape,
            conditioning.shape_tokens,
            self._shape_tokenizer.encode(""),
            bfloat16=self._shape_bfloat16,
            ends_in_plane=ends_in_plane,
            captured=captured,
        )

    def with_known_shape(
        self, conditioning: Conditioning, partial: Splats, distribution: ViewDistribution
    ) -> Conditioning:
        """Return the conditioning with a known shape of its noun; see :class:`base.KnowsShapes`."""
        assert isinstance(conditioning, EmbeddedConditioning)
        known = KnownShapes(self._bank, conditioning.prompt, decide=True)
        fitted = known.fitted(partial, distribution)
        return about_partial(conditioning, fitted[0]) if fitted else conditioning

    def likely_mirrors(
        self, partial: Splats, distribution: ViewDistribution, conditioning: Conditioning
    ) -> tuple[ChosenMirror, ...]:
        """Return what P may be mirrored through; see :class:`base.ShapePrior`."""
        cut = find_cut(partial.means.double().numpy(), flat_axes(partial))
        context = self.context(conditioning, ends_in_plane=ends_in_plane(cut))
        if context is None:
            return ()
        voxels = voxelize_partial(partial, distribution)
        scored = score_planes(
            context.model,
            voxels,
            context.tokens,
            ends_in_plane=context.ends_in_plane,
            bfloat16=context.bfloat16,
        )
        planes = (mirror_plane_of(plane) for plane in scored.distinct(voxels.positions))
        ends = mirror_of_half(partial, cut, HalfCut()) is not None
        return (*planes, *((HalfCut(),) if ends else ()), "none")

    def distill(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:  # []
        """Return the distillation loss; see :class:`gscomplete.priors.base.Prior`."""
        images = network_images(views.color, views.alpha, self.views.resolution_px)
        images = images.to(self._device)
        task = self._task(views, conditioning, input_views, guidance)
        with torch.no_grad():
            at = images.new_tensor(self._checked(timestep))
            noise = self._noise(images, generator)
            target = self._denoise(task, add_noise(images, noise, at), float(at))
        return 0.5 * fixed_sum((images - target).square()) / VIEWS

    @torch.no_grad()
    def reconstruct(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
        num_steps: int = 8,
    ) -> tuple[Tensor, Tensor]:  # [4, h, w, 3] premultiplied, [4, h, w]
        """Return clean targets; see :class:`gscomplete.priors.base.Prior`."""
        images = network_images(views.color, views.alpha, self.views.resolution_px)
        images = images.to(self._device)
        task = self._task(views, conditioning, input_views, guidance)
        start = self._checked(min(timestep, NUM_TIMESTEPS - 1.0))
        noisy = add_noise(images, self._noise(images, generator), images.new_tensor(start))
        clean = ddim(
            lambda x_t, at: self._denoise(task, x_t, at),
            scales_like(noisy),
            noisy,
            even_times(start, num_steps),
        )
        color, alpha = images_to_color_alpha(clean)
        return color.to(views.color.device), alpha.to(views.color.device)

    def _task(
        self,
        views: FourViews,
        conditioning: Conditioning,
        input_views: FourViews | None,
        guidance: Guidance | None,
    ) -> RingTask:
        """Gather what stays the same over the denoising steps of one call."""
        if not isinstance(conditioning, EmbeddedConditioning):
            raise TypeError(
                f"EmbeddedPrior: expected its own conditioning, found {type(conditioning).__name__}"
            )
        guidance = guidance or self.default_guidance(sees_input=input_views is not None)
        size_px = self.views.resolution_px
        return ring_task(views, conditioning, input_views, guidance, size_px, self._device)

    def _denoise(self, task: RingTask, noisy: Tensor, timestep: float) -> Tensor:  # [4, 4, s, s]
        """Return the guided x0 of one ring, within the range of images."""

        def network(*inputs: Tensor) -> Tensor:
            with torch.autocast(self._device.type, torch.bfloat16, enabled=self._bfloat16):
                return self._model(*inputs)

        return task.denoise(network, noisy, timestep)

    def _noise(self, images: Tensor, generator: torch.Generator) -> Tensor:
        noise = torch.randn(images.shape, generator=generator, device=generator.device)
        return noise.to(images)

    def _checked(self, timestep: float) -> float:
        if not 0 <= timestep <= NUM_TIMESTEPS - 1:
            raise ValueError(
                f"EmbeddedPrior: timestep: expected 0 to {NUM_TIMESTEPS - 1}, found {timestep}"
            )
        return float(timestep)


def load_embedded(folder: Path | None, device: torch.device | str) -> EmbeddedPrior:
    """Load the embedded prior.

    Args:
        folder: of weights; None = those of the package.
        device: where to run.

    Raises:
        UserError: the weights are missing or damaged, or the device cannot be used.
    """
    try:
        return EmbeddedPrior.from_folder(folder or packaged_weights(), device)
    except (RuntimeError, AssertionError) as error:
        raise UserError(f"prior: device: cannot use {device} ({error})") from error
