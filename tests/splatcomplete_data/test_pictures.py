"""Masks are read as they are meant, and large pictures are opened."""

import logging
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data import cli
from splatcomplete_data.dataset import build
from splatcomplete_data.mesh.files.textures import open_image
from splatcomplete_data.pictures import MAX_PIXELS, allow_large_pictures, eight_bits, read_mask

LEFT = np.zeros((6, 8), bool)
LEFT[:, :3] = True


def layers(*channels: np.ndarray | int) -> np.ndarray:
    return np.stack([np.broadcast_to(np.uint8(c), LEFT.shape) for c in channels], axis=-1)


WHITE = (LEFT * 255).astype(np.uint8)
KINDS = {
    "grey": WHITE,
    "two colours": LEFT,
    "0 and 1": LEFT.astype(np.uint8),
    "0 and 1 in 16 bits": LEFT.astype(np.uint16),
    "0 and 255 in 16 bits": LEFT.astype(np.uint16) * 255,
    "16 bits": LEFT.astype(np.uint16) * 65535,
    "RGB of 0 and 1": layers(LEFT, LEFT, LEFT),
    "one channel": layers(0, WHITE, 0),
    "alpha": layers(9, 9, 9, WHITE),
    "alpha of 0 and 1": layers(255, 255, 255, LEFT),
    "alpha that says nothing": layers(WHITE, WHITE, WHITE, 255),
    "grey and alpha that says nothing": layers(WHITE, 255),
}


@pytest.mark.parametrize("kind", KINDS)
def test_masks_of_every_kind(tmp_path: Path, kind: str) -> None:
    Image.fromarray(KINDS[kind]).save(tmp_path / "mask.png")
    mask = read_mask(tmp_path / "mask.png")
    assert mask.dtype == np.uint8
    np.testing.assert_array_equal(mask, WHITE)


def test_soft_and_black_masks_stay(tmp_path: Path) -> None:
    soft = np.linspace(0, 200, 48).astype(np.uint8).reshape(6, 8)
    Image.fromarray(soft).save(tmp_path / "soft.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "soft.png"), soft)
    Image.fromarray((soft / np.float32(200)).astype(np.float32)).save(tmp_path / "soft.tif")
    # rounded; in float32 a half may go either way
    found, exact = read_mask(tmp_path / "soft.tif"), soft / 200 * 255
    np.testing.assert_allclose(found, exact, rtol=0, atol=0.5 + 1e-4)
    Image.new("L", (8, 6)).save(tmp_path / "black.png")
    assert not read_mask(tmp_path / "black.png").any()


GREYS = np.array([[0, 64, 128, 255], [255, 1, 2, 3]], np.uint8)
WIDE = {
    "16 bits": (GREYS.astype(np.uint16) * 257, "png"),
    "32 bits": (GREYS.astype(np.int32) * 257, "tif"),
    "32 bits beyond 16": (GREYS.astype(np.int32) * 8_000_000, "tif"),
    "floats up to 1": (GREYS.astype(np.float32) / 255, "tif"),
    "floats up to 255": (GREYS.astype(np.float32), "tif"),
    "8 bits": (GREYS, "png"),
}


@pytest.mark.parametrize("kind", WIDE)
def test_wide_greys_are_scaled(tmp_path: Path, kind: str) -> None:
    values, suffix = WIDE[kind]
    Image.fromarray(values).save(tmp_path / f"a.{suffix}")
    with Image.open(tmp_path / f"a.{suffix}") as image:
        np.testing.assert_array_equal(np.asarray(eight_bits(image)), GREYS)


def test_a_dark_picture_of_16_bits_stays_dark() -> None:
    dark = Image.fromarray(np.full((2, 2), 200, np.uint16))
    assert np.asarray(eight_bits(dark)).tolist() == [[1, 1], [1, 1]]


def test_the_transparent_grey_of_16_bits_stays_transparent(tmp_path: Path) -> None:
    values = np.array([[0, 65535], [1000, 30000]], np.uint16)
    Image.fromarray(values).save(tmp_path / "a.png", transparency=1000)
    with Image.open(tmp_path / "a.png") as image:
        alpha = np.asarray(eight_bits(image).convert("RGBA"))[..., 3]
    assert alpha.tolist() == [[255, 255], [0, 255]]


def test_unreadable_masks_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match=r"none\.png: mask"):
        read_mask(tmp_path / "none.png")
    Image.new("L", (8, 6)).save(tmp_path / "large.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 20)
    with pytest.raises(UserError, match=r"large\.png: mask"):
        read_mask(tmp_path / "large.png")


def png_head(path: Path, width: int, height: int) -> Path:
    """The beginning of a picture of any size."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    data += struct.pack(">I", 0) + b"IDAT" + struct.pack(">I", zlib.crc32(b"IDAT"))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    return path


@pytest.mark.parametrize("entry", ["directly", "command line", "worker"])
def test_applications_open_large_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", Image.MAX_IMAGE_PIXELS)
    monkeypatch.setattr(logging.getLogger(), "level", logging.getLogger().level)
    monkeypatch.chdir(tmp_path)
    path = png_head(tmp_path / "large.png", 16_384, 16_384)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Image.MAX_IMAGE_PIXELS = 2**20
        with pytest.raises(UserError, match=r"large\.png"):
            open_image(path)
        if entry == "directly":
            allow_large_pictures()
        elif entry == "command line":
            assert cli.main(["validate", "nowhere"]) == 2
        else:
            build._enter(str(tmp_path))
        for width in (2**14, MAX_PIXELS // 2**14):
            with open_image(png_head(path, width, 2**14)) as image:
                assert image.size == (width, 2**14)
        with pytest.raises(UserError, match=r"large\.png: cannot read it as an image"):
            open_image(png_head(path, MAX_PIXELS // 2**14 + 1, 2**14))
