"""Training sets of the shape network: a pure function of (seed, index), and their stored form.

Conventions
-----------
* P and the complete object are transformed into a frame that is guessed from P as a run would guess
  it, so that the network is trained with the frame errors that it meets in use.
* ``solids`` defines which cells of the complete object count as solid.
* Colour volumes are stored as lists of filled cells: (x, y, z, r, g, b, occupancy) in eight bits.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gscomplete.framing.guess import FramingSettings, guess_framing
from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.shape.ask import turned
from gscomplete.shape.partial_voxels import ShapeInputs, voxelize_partial
from gscomplete.shape.planes.coarse_scorer import packaged_coarse_scorer
from gscomplete.shape.planes.fine_scorer import packaged_fine_scorer
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import (
    COPIES,
    SOURCES,
    SymmetryMap,
    mirror,
    no_symmetries,
    plane_of,
)
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.shape.voxels import (
    CELLS,
    COARSE_CELLS,
    fill_colored,
    splat_arrays,
)
from gscomplete.splats import Splats
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.arrays import Float32Array
from gscomplete.util.jsonio import dumps
from gscomplete.views import ObjectFrame, ViewDistribution
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data.copies import Truth
from recipes.train_embedded_prior.data.dataset import DISTURBED_SHARE, Source
from recipes.train_embedded_prior.data.findings import Findings, GuessedFrame
from recipes.train_embedded_prior.data.solids import solid_cells
from recipes.train_embedded_prior.data.user_parts import cut_again
from recipes.train_embedded_prior.procedural.quads import turn_about

_QUICK_FRAMING = FramingSettings(azimuths=12, elevations_deg=(15.0,), size_px=32, max_splats=3000)
"""The guess of runs at an eighth of its cost."""
TEXT_LENGTH = 16
MOST_CELLS = 4096
"""Most filled cells stored of P and of each of its mirror images."""
MOST_SURFACE_CELLS = 6144
"""Most surface cells stored of the complete object."""
_GUESS_SHARE = 0.7
"""Share of sets whose frame and input view are guessed from P, as runs guess them; the others have
the true frame with a small error."""
_FRAME_JITTER = 0.04
"""Standard deviation of the error of frames that are not guessed, object sizes."""
_NO_COPY_SHARE = 0.08
"""Share of sets without mirror images, whatever their score."""
_BEST_COPY_SHARE = 0.5
"""Share of the others whose first mirror image is the best by the truth of the candidates; in the
rest it is the likeliest. (Taking any of them, as runs ask before they choose, was tried in 30 % of
the sets: the network's answers then told right planes from wrong ones less well.)"""
_LEAST_SCORE = 0.05
"""Where the best by the truth scores less, there are no mirror images either."""
_STRAIGHT_SHARE = 0.3
"""Share of variants that are not turned: models stand straight in files."""
_CUT_AGAIN_SHARE = 0.4
_VIEW_JITTER_DEG = 12.0


@dataclass(frozen=True, slots=True)
class ShapeBatch:
    """Training sets as the shape network takes them."""

    volumes: Tensor  # [B, SOURCES, 4, C, C, C]
    evidence: Tensor  # [B, 3, C/2, C/2, C/2]
    scores: Tensor  # [B, COPIES]
    tokens: Tensor  # [B, L]
    solid: Tensor  # [B, C, C, C] 0 or 1
    surface: Tensor  # [B, 4, C, C, C] of the complete object: occupancy and colour

    def to(self, device: str) -> ShapeBatch:
        """Return the sets on a device."""
        return ShapeBatch(
            **{f.name: getattr(self, f.name).to(device) for f in dataclasses.fields(self)}
        )


def set_dtype() -> np.dtype:
    """Record layout of one stored set."""
    return np.dtype(
        [
            ("cells", "u1", (SOURCES, MOST_CELLS, 7)),
            ("evidence", "u1", (3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS)),
            ("scores", "f4", (COPIES,)),
            ("tokens", "i2", (TEXT_LENGTH,)),
            ("solid", "u1", (CELLS**3 // 8,)),
            ("surface", "u1", (MOST_SURFACE_CELLS, 7)),
        ]
    )


@dataclass(frozen=True, slots=True)
class ShapeSpec:
    """What the shards hold."""

    source: Source
    data: ShapeDataConfig
    words: tuple[str, ...]
    seed: int
    shard_sets: int

    def maker(self, seed: int | None = None) -> Callable[[int], np.ndarray]:
        """Return the function that makes the sets, of another seed if one is given."""
        chosen = self.seed if seed is None else seed
        return ShapeSetMaker(self.source, self.data, Tokenizer(self.words, TEXT_LENGTH), chosen)

    def key(self) -> str:
        """Name the contents: folders of different options never mix."""
        planes = [packaged_coarse_scorer().digest(), packaged_fine_scorer().digest()]
        text = dumps([self.data, self.words, self.seed, planes, "shape"])
        return hashlib.sha256(f"{text}{self.shard_sets}".encode()).hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class PosedObject:
    """A part and the complete object in the frame guessed from the part."""

    partial: Splats
    complete: Splats
    distribution: ViewDistribution
    caption: str
    guess: GuessedFrame
    """What the frame was made from."""

    def planes(self) -> tuple[SymmetryMap, ...]:
        """Return the planes of symmetry that a run would ask about, the likeliest first."""
        look = voxelize_partial(self.partial, self.distribution)
        return tuple(candidate_planes(look, CANDIDATES, bfloat16=True))


@dataclass(frozen=True, slots=True)
class ShapeSetMaker:
    """Make stored sets by index."""

    source: Source
    data: ShapeDataConfig
    tokenizer: Tokenizer
    seed: int

    def __call__(self, index: int) -> np.ndarray:  # [] of set_dtype
        """Make set ``index``."""
        return self.variants(index, 1)[0]

    def variants(
        self, index: int, count: int, known: Findings | None = None
    ) -> list[np.ndarray]:  # count of set_dtype
        """Make set ``index`` and variants of it (``varied``), a sixth of its work each.

        Args:
            index: of the part.
            count: how many sets.
            known: findings about the part that were computed before; None = compute them now.
        """
        rng = np.random.default_rng((self.seed, index, 2))
        posed = self.posed(index, rng, known)
        planes = (
            known.planes if known is not None and known.are_of(posed.partial) else posed.planes()
        )
        sets = [self._stored(posed, planes, rng)]
        for variant in range(1, count):
            rng = np.random.default_rng((self.seed, index, 2, variant))
            sets.append(self._stored(*varied(posed, planes, rng), rng))
        return sets

    def findings(self, index: int) -> Findings:
        """Compute the findings of part ``index``, which take most of a set's time."""
        posed = self.posed(index, np.random.default_rng((self.seed, index, 2)))
        return Findings(len(posed.partial), posed.guess, posed.planes())

    def _stored(
        self, posed: PosedObject, planes: Sequence[SymmetryMap], rng: np.random.Generator
    ) -> np.ndarray:  # [] of set_dtype
        seen = _shown(posed, planes, rng)
        stored = np.zeros((), set_dtype())
        for n, volume in enumerate(seen.volumes):
            stored["cells"][n] = pack_cells(volume, MOST_CELLS, rng)
        stored["evidence"] = np.round(seen.evidence * 255)
        stored["scores"] = seen.scores
        stored["tokens"] = self.tokenizer.encode(posed.caption).numpy()
        complete = splat_arrays(posed.complete)
        stored["solid"] = np.packbits(solid_cells(complete[0], complete[1]))
        surface = fill_colored(*complete, CELLS)
        stored["surface"] = pack_cells(surface, MOST_SURFACE_CELLS, rng)
        return stored

    def posed(
        self, index: int, rng: np.random.Generator, known: Findings | None = None
    ) -> PosedObject:
        """Return object ``index`` and a part of it in a frame as a run would guess it."""
        item = self.source(self.seed, index)
        disturb = bool(rng.random() < DISTURBED_SHARE)
        slight = np.random.default_rng((self.seed, index, 3)).random() < self.data.slight_share
        partial = item.partial(disturb=disturb, slight=bool(slight))
        if known is not None and known.are_of(partial):
            guess = known.guess
        else:
            found = guess_framing(partial, _QUICK_FRAMING)
            guess = GuessedFrame(found.center, found.size, found.view_azimuth_deg)
        frame, distribution = _frame(guess, rng)
        to_frame = frame.object_from_file
        return PosedObject(
            transform_splats(partial, to_frame),
            transform_splats(item.splats, to_frame),
            distribution,
            item.caption,
            guess,
        )


def _frame(guess: GuessedFrame, rng: np.random.Generator) -> tuple[ObjectFrame, ViewDistribution]:
    """Take the guessed frame and view, or the true frame with an error."""
    center, size = np.array(guess.center), guess.size
    if rng.random() >= _GUESS_SHARE:
        center = rng.normal(scale=_FRAME_JITTER, size=3)
        size = float(np.exp(rng.normal(scale=_FRAME_JITTER)))
    elevation = float(rng.choice([0.0, 15.0, 30.0]))
    x, y, z = center.tolist()
    return ObjectFrame("Z", (x, y, z), size), ViewDistribution(guess.azimuth_deg, elevation)


def _shown(
    posed: PosedObject, planes: Sequence[SymmetryMap], rng: np.random.Generator
) -> ShapeInputs:
    """Show P with the likeliest mirror image first, or the best by the truth, or none.

    Runs choose among the same candidates by the network's answers, better than the likeliest.
    """
    look = voxelize_partial(posed.partial, posed.distribution)
    if rng.random() < _NO_COPY_SHARE:
        return look.with_copies(no_symmetries())
    first = 0
    if rng.random() < _BEST_COPY_SHARE:
        truth = Truth.of(posed.partial, posed.complete)
        true_scores = [truth.map_score(plane) for plane in planes]
        first = int(np.argmax(true_scores))
        if true_scores[first] < _LEAST_SCORE:
            return look.with_copies(no_symmetries())
    return look.with_copies(look.input_symmetries(planes, first))


def varied(
    posed: PosedObject, planes: Sequence[SymmetryMap], rng: np.random.Generator
) -> tuple[PosedObject, tuple[SymmetryMap, ...]]:
    """Turn, move and scale an object, look at it from elsewhere, and often cut its part again.

    The part's findings are transformed with it, not computed again: a part that is cut again keeps
    the planes of the larger one.
    """
    yaw_deg = 0.0 if rng.random() < _STRAIGHT_SHARE else float(rng.uniform(0, 360))
    move = Similarity(
        float(np.exp(rng.normal(scale=_FRAME_JITTER))),
        torch.from_numpy(turn_about("z", yaw_deg)).double(),
        torch.from_numpy(rng.normal(scale=_FRAME_JITTER, size=3)),
    )
    azimuth_deg = posed.distribution.azimuth_deg + yaw_deg + rng.normal(scale=_VIEW_JITTER_DEG)
    elevation_deg = float(rng.choice([0.0, 15.0, 30.0]))
    partial = posed.partial
    if rng.random() < _CUT_AGAIN_SHARE:
        partial = cut_again(partial, rng)
    moved = dataclasses.replace(
        posed,
        partial=transform_splats(partial, move),
        complete=transform_splats(posed.complete, move),
        distribution=ViewDistribution(azimuth_deg % 360.0, elevation_deg),
    )
    return moved, tuple(_moved_plane(plane, move, math.radians(yaw_deg)) for plane in planes)


def _moved_plane(plane: SymmetryMap, move: Similarity, yaw: float) -> SymmetryMap:
    angle, offset = plane_of(plane)
    x, y, _ = move.translation.tolist()
    along = x * math.cos(angle + yaw) + y * math.sin(angle + yaw)
    return mirror(angle + yaw, move.scale * offset + along, plane.score)


def pack_cells(
    volume: Float32Array,  # [4, C, C, C]
    most: int,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:  # [most, 7]
    """List the filled cells, a random choice of them where there are too many."""
    filled = np.argwhere(volume[0] > 0)
    if len(filled) > most:
        filled = filled[np.sort(rng.choice(len(filled), most, replace=False))]
    x, y, z = filled.T
    packed = np.zeros((most, 7), np.uint8)
    packed[: len(filled), :3] = filled
    packed[: len(filled), 3:6] = np.round(volume[1:, x, y, z].T * 255)
    packed[: len(filled), 6] = np.maximum(np.round(volume[0, x, y, z] * 255), 1)
    return packed


def unpack_cells(
    packed: NDArray[np.uint8],  # [K, most, 7]
) -> Float32Array:  # [K, 4, C, C, C]
    """Undo :func:`pack_cells` for many volumes."""
    volumes = np.zeros((len(packed), 4, CELLS**3), np.float32)
    for volume, cells in zip(volumes, packed, strict=True):
        filled = cells[cells[:, 6] > 0]
        x, y, z = filled[:, :3].T.astype(np.intp)
        place = (x * CELLS + y) * CELLS + z
        for channel, column in enumerate((6, 3, 4, 5)):
            volume[channel, place] = filled[:, column].astype(np.float32) / 255
    return volumes.reshape(-1, 4, CELLS, CELLS, CELLS)


def decode_sets(stored: np.ndarray) -> ShapeBatch:  # [B] of set_dtype
    """Turn stored sets into a batch."""
    seen = unpack_cells(stored["cells"].reshape(-1, MOST_CELLS, 7))
    bits = np.unpackbits(stored["solid"], axis=1).reshape(-1, CELLS, CELLS, CELLS)
    return ShapeBatch(
        torch.from_numpy(seen.reshape(-1, SOURCES, *seen.shape[1:])),
        torch.from_numpy(np.ascontiguousarray(stored["evidence"])).float() / 255,
        torch.from_numpy(np.ascontiguousarray(stored["scores"])),
        torch.from_numpy(stored["tokens"].astype(np.int64)),
        torch.from_numpy(bits).float(),
        torch.from_numpy(unpack_cells(stored["surface"])),
    )


def joined(batches: Sequence[ShapeBatch]) -> ShapeBatch:
    """Put batches one after the other."""
    names = [field.name for field in dataclasses.fields(ShapeBatch)]
    return ShapeBatch(**{n: torch.cat([getattr(b, n) for b in batches]) for n in names})


def turn_batch(batch: ShapeBatch, turns: int, mirror: bool) -> ShapeBatch:
    """Turn all volumes by quarter turns about z, and mirror them: the same objects anew."""
    return dataclasses.replace(
        batch,
        volumes=turned(batch.volumes, turns, mirror),
        evidence=turned(batch.evidence, turns, mirror),
        solid=turned(batch.solid, turns, mirror),
        surface=turned(batch.surface, turns, mirror),
    )
