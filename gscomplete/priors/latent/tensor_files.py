"""Files of named tensors, opened lazily and compared with what a model needs.

Conventions
-----------
* A ``.pt``, ``.pth``, ``.th``, ``.ckpt`` or ``.bin`` file is PyTorch's, read without running any
  code in it and mapped into memory where its form allows; anything else is safetensors.
* Shapes are known at once, values are read when asked for.
* :func:`check_tensors` is the one place that refuses a file, and says by name what differs.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from gscomplete.errors import UserError

Shape = tuple[int, ...]

TORCH_SUFFIXES = (".pt", ".pth", ".th", ".ckpt", ".bin")
_SHOWN = 3
_BLOCKS, _BLOCK_BYTES = 64, 2**16


@dataclass(frozen=True, slots=True)
class Source:
    """Where a tensor of a network is found in a file, and which part of what is there it is."""

    name: str
    """Name in the file (for MVDream's published file, without prefix)."""
    third: int | None = None
    """Which third of the first axis (stacked q, k, v); None = all of it."""
    squeeze: bool = False
    """Whether the file's tensor has two more axes of length 1 (a 1 x 1 kernel for a matrix)."""

    def original_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the shape in the file for the network's shape."""
        if self.third is not None:
            shape = (3 * shape[0], *shape[1:])
        return (*shape, 1, 1) if self.squeeze else shape

    def take(self, original: Tensor) -> Tensor:
        """Return the network's tensor."""
        if self.third is not None:
            original = original.chunk(3)[self.third]
        return original[:, :, 0, 0] if self.squeeze else original


class TensorFile:
    """Named tensors of one file."""

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            UserError: it is missing, damaged or cut short, or holds anything but named tensors.
        """
        self.path = path
        self._tensors: dict[str, Tensor] | None = None
        if not path.is_file():
            raise UserError(f"{path}: expected a file of weights, found nothing")
        if path.suffix in TORCH_SUFFIXES:
            self._tensors = _read_torch(path)
            self.shapes = {name: tuple(value.shape) for name, value in self._tensors.items()}
        else:
            self.shapes = _safetensors_shapes(path)

    def get(self, name: str) -> Tensor:
        """Read one tensor.

        Raises:
            UserError: the file has been damaged since it was opened, or a value is not finite.
        """
        if self._tensors is not None:
            return self._finite(name, self._tensors[name])
        try:
            with safe_open(self.path, framework="pt") as file:
                return self._finite(name, file.get_tensor(name))
        except (SafetensorError, OSError) as error:
            raise UserError(f"{self.path}: cannot read {name} ({error})") from error

    def get_all(self, names: Iterable[str]) -> dict[str, Tensor]:
        """Read several tensors, opening the file once."""
        if self._tensors is not None:
            return {name: self._finite(name, self._tensors[name]) for name in names}
        try:
            with safe_open(self.path, framework="pt") as file:
                return {name: self._finite(name, file.get_tensor(name)) for name in names}
        except (SafetensorError, OSError) as error:
            raise UserError(f"{self.path}: cannot read it ({error})") from error

    def _finite(self, name: str, tensor: Tensor) -> Tensor:
        """Return a tensor whose values are all finite.

        Raises:
            UserError: they are not.
        """
        odd = int((~tensor.isfinite()).sum())
        if odd:
            raise UserError(f"{self.path}: {name}: expected finite values, found {odd:,} others")
        return tensor


def check_tensors(
    path: Path,
    found: Mapping[str, Shape],
    expected: Mapping[str, Shape],
    *,
    optional: Iterable[str] = (),
    what: str = "the model",
) -> None:
    """Compare the tensors of a file with those that are needed, strictly.

    Args:
        path: named in the error.
        found: name to shape.
        expected: name to shape; all of these and no others.
        optional: names that may be there or not.
        what: they are needed for.

    Raises:
        UserError: a tensor is missing, unexpected or of another shape; the message names the first
            few of each and counts them.
    """
    allowed = set(optional)
    missing = [name for name in expected if name not in found]
    extra = [name for name in found if name not in expected and name not in allowed]
    other = [
        f"{name} (expected {_show(expected[name])}, found {_show(found[name])})"
        for name in expected
        if name in found and tuple(found[name]) != tuple(expected[name])
    ]
    differences = [
        f"{title} {len(names)}: {_first(names)}"
        for title, names in (("missing", missing), ("unexpected", extra), ("other shape", other))
        if names
    ]
    if differences:
        raise UserError(
            f"{path}: expected the {len(expected)} tensors of {what}, found {len(found)}; "
            + "; ".join(differences)
        )


def fingerprint(paths: Iterable[Path]) -> str:
    """Return a digest of files from their sizes and samples of their content.

    Files of gigabytes are not read whole at every start: 64 blocks spread evenly tell apart any
    two published or retrained files, though not a change made on purpose between them.
    """
    digest = hashlib.sha256()
    for path in paths:
        size = path.stat().st_size
        digest.update(f"{size}/".encode())
        with path.open("rb") as file:
            for block in range(_BLOCKS):
                file.seek(max(0, size - _BLOCK_BYTES) * block // (_BLOCKS - 1))
                digest.update(file.read(_BLOCK_BYTES))
    return digest.hexdigest()[:32]


def _read_torch(path: Path) -> dict[str, Tensor]:
    """Read PyTorch's file of named tensors; older forms cannot be mapped and are read whole."""
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                if any(member.compress_type for member in archive.infolist()):
                    raise ValueError("its members are compressed, which PyTorch never writes")
        try:
            data = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        except RuntimeError as error:
            if "mmap" not in str(error):
                raise
            data = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the reader of damaged files raises whatever it stumbles over
        reason = str(error).strip().split("\n")[0][:200]
        raise UserError(
            f"{path}: expected PyTorch's file of named tensors, found damage, a cut, or something "
            f"else ({reason})"
        ) from error
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected named tensors, found {type(data).__name__}")
    for name, value in data.items():
        if not isinstance(value, Tensor):
            raise UserError(
                f"{path}: {name}: expected a tensor, found {type(value).__name__}; expected the "
                "names of tensors at the top level"
            )
    return data


def _safetensors_shapes(path: Path) -> dict[str, Shape]:
    try:
        with safe_open(path, framework="pt") as file:
            return {
                name: tuple(file.get_slice(name).get_shape())
                for name in file.keys()  # noqa: SIM118
            }
    except (SafetensorError, OSError) as error:
        raise UserError(
            f"{path}: expected a safetensors file, found damage or a cut ({error})"
        ) from error


def _first(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _show(shape: Shape) -> str:
    return "x".join(map(str, shape)) or "scalar"
