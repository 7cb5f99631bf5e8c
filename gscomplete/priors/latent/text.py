"""Prompts to embeddings, remembered on disk so that the text tower is hardly ever loaded.

Conventions
-----------
* An embedding is [77, width] float32: the tower's last hidden state, which for MVDream's tower
  (23 of 24 blocks) is the penultimate block after the final norm.
* One safetensors file per prompt in the cache folder, named by a digest of the token ids and of
  the tower's weights; what is found there is used only if its shape and digest fit.
* The tower is read, moved to the device, used and let go; it never stays there.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.latent.tokenizer import Tokenizer, Tokens
from gscomplete.util.atomic import atomic_path

CACHE_VARIABLE = "GSCOMPLETE_CACHE"
"""Environment variable: the folder for caches and weights; default ``~/.cache/gscomplete``."""


def cache_home() -> Path:
    """Return the folder of caches and fetched weights."""
    named = os.environ.get(CACHE_VARIABLE)
    return Path(named) if named else Path.home() / ".cache" / "gscomplete"


@dataclass(frozen=True, slots=True)
class PromptEncoder:
    """Turns prompts into embeddings for one set of weights."""

    tokenizer: Tokenizer
    load_tower: Callable[[], Any]
    """Reads the text tower; called only for prompts that are not in the cache."""
    tower_digest: str
    """Tells towers apart."""
    shape: tuple[int, int]
    """Of an embedding."""
    device: torch.device
    cache: Path | None
    """Folder of remembered embeddings; None = remember nothing."""

    def encode(self, prompts: list[str]) -> list[Tensor]:  # of [length, width] float32 on the CPU
        """Return the embedding of every prompt, from the cache where it has them."""
        tokens = [self.tokenizer.encode(prompt) for prompt in prompts]
        known = {t.ids: self._remembered(t) for t in tokens}
        missing = [ids for ids, embedding in known.items() if embedding is None]
        if missing:
            known.update(zip(missing, self._run_tower(missing), strict=True))
            for token in tokens:
                if token.ids in missing:
                    self._remember(token, known[token.ids])
        found = [known[t.ids] for t in tokens]
        return [embedding for embedding in found if embedding is not None]

    def report(self, what: str, prompt: str) -> tuple[str, ...]:
        """Return a line if a prompt was too long."""
        dropped = self.tokenizer.encode(prompt).dropped
        if not dropped:
            return ()
        return (f"{what}: too long, the last {dropped} of its tokens are left out",)

    @torch.no_grad()
    def _run_tower(self, ids: list[tuple[int, ...]]) -> list[Tensor]:
        tower = self.load_tower().float().to(self.device)
        batch = torch.tensor(ids, dtype=torch.int64, device=self.device)
        hidden = tower(input_ids=batch).last_hidden_state
        return [row.float().cpu().contiguous() for row in hidden]

    def _file(self, tokens: Tokens) -> Path | None:
        if self.cache is None:
            return None
        text = json.dumps([self.tower_digest, list(tokens.ids)])
        return self.cache / f"{hashlib.sha256(text.encode()).hexdigest()[:40]}.safetensors"

    def _remembered(self, tokens: Tokens) -> Tensor | None:
        path = self._file(tokens)
        if path is None or not path.is_file():
            return None
        try:
            with safe_open(path, framework="pt") as file:
                embedding: Tensor = file.get_tensor("embedding")
                digest = (file.metadata() or {}).get("tower")
        except (SafetensorError, OSError):
            return None  # damaged: computed and written again
        fits = digest == self.tower_digest and tuple(embedding.shape) == self.shape
        return embedding if fits and bool(torch.isfinite(embedding).all()) else None

    def _remember(self, tokens: Tokens, embedding: Tensor | None) -> None:
        """Write an embedding to the cache; a cache that cannot be written is done without."""
        path = self._file(tokens)
        if path is None or embedding is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(path) as temporary:
                temporary.write_bytes(
                    save({"embedding": embedding}, metadata={"tower": self.tower_digest})
                )
        except (OSError, UserError):
            return
