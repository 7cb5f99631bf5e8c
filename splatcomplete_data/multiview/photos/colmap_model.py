"""Read a COLMAP model: ``cameras``, ``images`` and ``points3D`` as .bin or .txt.

Conventions
-----------
* COLMAP stores camera-from-world as a quaternion (w, x, y, z) and a translation, with OpenCV axes
  and pixel centres at +0.5: the same as ours, so nothing is converted.
* ``rigs`` and ``frames`` files of newer versions are not needed: images still hold their poses.
* Photos may be scaled copies of those that the model was made from: their lens is scaled along
  when the aspect ratio is the same to a pixel, else it is an error.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError
from gscomplete.splats.rotations import matrix_rows
from gscomplete.util.arrays import Float64Array
from splatcomplete_data.multiview.photos.images import photo_size
from splatcomplete_data.multiview.photos.lens import Lens
from splatcomplete_data.multiview.photos.posed import PosedPhoto, PosedPhotos
from splatcomplete_data.named_files import Reach
from splatcomplete_data.scan import PointCloud

_PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
}
"""Camera models that are understood, and how many numbers each has."""
_MODEL_IDS = {
    0: "SIMPLE_PINHOLE",
    1: "PINHOLE",
    2: "SIMPLE_RADIAL",
    3: "RADIAL",
    4: "OPENCV",
    5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV",
}
_MAX_TRACK = 1 << 20


@dataclass(frozen=True, slots=True)
class _Image:
    """One registered image as the model stores it."""

    name: str
    camera_id: int
    quaternion: tuple[float, ...]  # wxyz
    translation: tuple[float, ...]


class _Bytes:
    """A binary file read front to back, which never reads past its end."""

    def __init__(self, path: Path) -> None:
        self._path, self._offset = path, 0
        self._data = _read(path)

    def take(self, form: str) -> tuple[float, ...]:
        """Unpack little-endian numbers."""
        size = struct.calcsize("<" + form)
        self.require(size)
        values = struct.unpack_from("<" + form, self._data, self._offset)
        self._offset += size
        return values

    def text(self) -> str:
        """Read a zero-terminated text."""
        end = self._data.find(b"\0", self._offset)
        if end < 0:
            raise UserError(f"{self._path}: truncated: an image name has no end")
        raw = self._data[self._offset : end]
        self._offset = end + 1
        return raw.decode("utf-8", errors="replace")

    def skip(self, size: int) -> None:
        """Pass over bytes."""
        self.require(size)
        self._offset += size

    def require(self, size: int) -> None:
        """Refuse to go past the end.

        Raises:
            UserError: fewer than ``size`` bytes are left.
        """
        left = len(self._data) - self._offset
        if size > left:
            raise UserError(
                f"{self._path}: truncated: expected {size} more bytes at offset {self._offset}, "
                f"found {left}"
            )


def find_model(folder: Path) -> Path | None:
    """Return the folder of a COLMAP model in or under ``folder``: itself, sparse/0, sparse."""
    for candidate in (
        folder,
        folder / "sparse" / "0",
        folder / "sparse",
        folder / "colmap/sparse/0",
    ):
        if any((candidate / f"images{suffix}").is_file() for suffix in (".bin", ".txt")):
            return candidate
    return None


def read_colmap(model: Path, images: Path, allow_outside: Path | None = None) -> PosedPhotos:
    """Read a model and match it with its photos.

    Args:
        model: folder with cameras, images and, if there are any, points3D.
        images: folder of the photos; names in the model are relative to it.
        allow_outside: folder below which photos are read, too; None = only those below ``images``.

    Raises:
        UserError: a file is missing, truncated or of an unknown camera model, a photo has another
            shape than its camera, or fewer than three photos exist.
    """
    images_path, cameras_path = _part(model, "images"), _part(model, "cameras")
    binary = cameras_path.suffix == ".bin"
    lenses = dict(_cameras_bin(cameras_path) if binary else _cameras_txt(cameras_path))
    stored = _stored_images(images_path)
    photos, missing = [], []
    reach = Reach.of(images / "any", allow_outside)
    for image in stored:
        path = images / image.name
        if not path.is_file():
            missing.append(image.name)
            continue
        refusal = reach.refusal(path)
        if refusal is not None:
            raise UserError(f"{images_path}: photo {image.name} {refusal}")
        if image.camera_id not in lenses:
            raise UserError(
                f"{images_path}: {image.name}: camera {image.camera_id} is not in {cameras_path}"
            )
        lens = _fit_to_photo(lenses[image.camera_id], path)
        photos.append(PosedPhoto(path, lens, _pose(image, images_path)))
    notes: tuple[str, ...] = ()
    if missing:
        notes = (
            f"{len(missing)} of {len(stored)} images of the model left out: not in {images} "
            f"(first: {missing[0]})",
        )
    return PosedPhotos(tuple(photos), read_points(model), str(model), notes)


def image_names(model: Path) -> list[str]:
    """Return the names of a model's registered images, sorted.

    Raises:
        UserError: the model has no images file, or it is truncated or malformed.
    """
    return [image.name for image in _stored_images(_part(model, "images"))]


def _part(model: Path, name: str) -> Path:
    """Return the file of a part of a model, binary where its images are.

    Raises:
        UserError: it is missing.
    """
    path = model / (name + (".bin" if (model / "images.bin").is_file() else ".txt"))
    if not path.is_file():
        raise UserError(f"{model}: expected a COLMAP model with {path.name}, found none")
    return path


def _stored_images(path: Path) -> list[_Image]:
    """Return the registered images by name."""
    images = _images_bin(path) if path.suffix == ".bin" else _images_txt(path)
    return sorted(images, key=lambda image: image.name)


def lens_from_colmap(name: str, width: int, height: int, numbers: tuple[float, ...]) -> Lens:
    """Build a lens from a COLMAP camera.

    Raises:
        ValueError: the camera model is not understood, or a number is out of range.
    """
    if name not in _PARAMETERS:
        raise ValueError(
            f"camera model {name} is not understood; expected one of {', '.join(_PARAMETERS)}. "
            "Undistort the photos first (colmap image_undistorter)"
        )
    if len(numbers) != _PARAMETERS[name]:
        raise ValueError(f"{name}: expected {_PARAMETERS[name]} numbers, found {len(numbers)}")
    single = name in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    focal = (numbers[0], numbers[0]) if single else (numbers[0], numbers[1])
    rest = numbers[1:] if single else numbers[2:]
    k, p = [0.0] * 6, (0.0, 0.0)
    if name in ("SIMPLE_RADIAL", "RADIAL"):
        k[: len(rest) - 2] = rest[2:]
    elif name == "OPENCV_FISHEYE":
        k[:4] = rest[2:]
    elif name in ("OPENCV", "FULL_OPENCV"):
        k[:2], p = rest[2:4], (rest[4], rest[5])
        k[2 : 2 + len(rest) - 6] = rest[6:]
    kind = "fisheye" if name == "OPENCV_FISHEYE" else "brown"
    radial = (k[0], k[1], k[2], k[3], k[4], k[5])
    return Lens(width, height, focal, (rest[0], rest[1]), kind, radial, p)  # type: ignore[arg-type]


def _read(path: Path) -> bytes:
    """Return a file's bytes.

    Raises:
        UserError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot read it ({error.strerror})") from error


def _camera(path: Path, name: str, width: float, height: float, numbers: tuple[float, ...]) -> Lens:
    """Build a lens, naming the file in errors."""
    try:
        return lens_from_colmap(name, int(width), int(height), numbers)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error


def _cameras_bin(path: Path) -> Iterator[tuple[int, Lens]]:
    """Yield (camera id, lens)."""
    stream = _Bytes(path)
    (count,) = stream.take("Q")
    for _ in range(int(count)):
        camera_id, model_id, width, height = stream.take("iiQQ")
        name = _MODEL_IDS.get(int(model_id), f"number {int(model_id)}")
        numbers = stream.take(f"{_PARAMETERS.get(name, 0)}d")
        yield int(camera_id), _camera(path, name, width, height, numbers)


def _images_bin(path: Path) -> Iterator[_Image]:
    """Yield the registered images."""
    stream = _Bytes(path)
    (count,) = stream.take("Q")
    for _ in range(int(count)):
        numbers = stream.take("i7di")
        name = stream.text()
        (observations,) = stream.take("Q")
        stream.skip(24 * int(observations))
        yield _Image(name, int(numbers[8]), numbers[1:5], numbers[5:8])


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of the lines that are not comments."""
    text = _read(path).decode("utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        if not line.startswith("#"):
            yield number, line.split()


def _cameras_txt(path: Path) -> Iterator[tuple[int, Lens]]:
    """Yield (camera id, lens)."""
    for number, words in _lines(path):
        if not words:
            continue
        try:
            camera_id, width, height = int(words[0]), int(words[2]), int(words[3])
            numbers = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise UserError(
                f"{path}: line {number}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS..."
            ) from error
        yield camera_id, _camera(path, words[1], width, height, numbers)


def _images_txt(path: Path) -> Iterator[_Image]:
    """Yield the registered images: every second line, the others hold their 2D points."""
    for index, (number, words) in enumerate(_lines(path)):
        if index % 2:
            continue
        if not words:
            continue
        try:
            numbers = tuple(float(word) for word in words[1:8])
            camera_id, name = int(words[8]), " ".join(words[9:])
        except (ValueError, IndexError) as error:
            raise UserError(
                f"{path}: line {number}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            ) from error
        yield _Image(name, camera_id, numbers[:4], numbers[4:7])


def read_points(model: Path) -> PointCloud | None:
    """Read a model's sparse cloud; None when it has none.

    Raises:
        UserError: the file is truncated or malformed.
    """
    binary, text = model / "points3D.bin", model / "points3D.txt"
    if binary.is_file():
        rows = list(_points_bin(binary))
    elif text.is_file():
        rows = list(_points_txt(text))
    else:
        return None
    table = np.array(rows, np.float64).reshape(-1, 6)
    table = table[np.isfinite(table).all(axis=1)]
    if not len(table):
        return None
    return PointCloud(table[:, :3], (table[:, 3:] / 255.0).astype(np.float32))


def _points_bin(path: Path) -> Iterator[tuple[float, ...]]:
    """Yield (x, y, z, red, green, blue)."""
    stream = _Bytes(path)
    (count,) = stream.take("Q")
    for _ in range(int(count)):
        numbers = stream.take("Q3d3BdQ")
        if numbers[8] > _MAX_TRACK:
            raise UserError(f"{path}: expected a track of a few images, found {numbers[8]}")
        stream.skip(8 * int(numbers[8]))
        yield numbers[1:7]


def _points_txt(path: Path) -> Iterator[tuple[float, ...]]:
    """Yield (x, y, z, red, green, blue)."""
    for number, words in _lines(path):
        if not words:
            continue
        try:
            row = tuple(float(word) for word in words[1:7])
        except ValueError as error:
            raise UserError(f"{path}: line {number}: expected ID X Y Z R G B ...") from error
        if len(row) != 6:
            raise UserError(f"{path}: line {number}: expected ID X Y Z R G B ...")
        if any(value < 0 or value > 255 for value in row[3:]):
            raise UserError(f"{path}: line {number}: expected a colour of 0 to 255")
        yield row


def _pose(image: _Image, path: Path) -> Float64Array:  # [4, 4]
    """Turn a stored pose into a matrix.

    Raises:
        UserError: the quaternion has no length, or a number is not finite.
    """
    quaternion = np.array(image.quaternion, np.float64)
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(quaternion).all() and np.isfinite(image.translation).all() and length > 0):
        raise UserError(f"{path}: {image.name}: expected a finite pose, found {image}")
    pose = np.eye(4)
    pose[:3, :3] = matrix_rows(*quaternion / length)
    pose[:3, 3] = image.translation
    return pose


def _fit_to_photo(lens: Lens, path: Path) -> Lens:
    """Scale a lens to the photo's size.

    Raises:
        UserError: the photo is not a picture, or has another shape.
    """
    width, height = photo_size(path)
    if abs(width * lens.height / lens.width - height) > 1.0:
        raise UserError(
            f"{path}: expected the shape of its camera, {lens.width} x {lens.height}, found "
            f"{width} x {height}"
        )
    return lens.resized(width, height)
