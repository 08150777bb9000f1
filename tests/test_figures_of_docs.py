"""Figures of the documentation are what stored data give."""

import runpy
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter
from places import CHECKOUT

PROGRAM = runpy.run_path(str(CHECKOUT / "scripts" / "stale_figures.py"))


def png_of(picture: Image.Image) -> bytes:
    """Bytes of a picture."""
    file = BytesIO()
    picture.save(file, "png")
    return file.getvalue()


def test_a_mark_that_moves_is_a_difference_and_smoothing_is_none() -> None:
    """A mark that moves by its width is found, and so is another size; edges that are smoothed otherwise are not."""
    pixels = np.full((240, 320, 3), 255, dtype=np.uint8)
    pixels[100:108, 50:58] = 0
    kept = Image.fromarray(pixels)
    moved = Image.fromarray(np.roll(pixels, 8, axis=1))
    assert PROGRAM["difference"](png_of(kept), png_of(moved)) > PROGRAM["_LARGEST"]
    assert PROGRAM["difference"](png_of(kept), png_of(kept.resize((160, 120)))) == 1.0
    assert PROGRAM["difference"](png_of(kept), png_of(kept.filter(ImageFilter.GaussianBlur(0.5)))) < PROGRAM["_LARGEST"]


def test_the_gallery_was_drawn_from_the_data_that_ship() -> None:
    """Its page lists all figures, and the files that they were drawn from have not changed since."""
    assert PROGRAM["stale_sources"]() == []


@pytest.mark.full
def test_no_figure_of_the_gallery_is_stale() -> None:
    """All figures drawn anew from stored data are those of docs/gallery; the build of the site asks the same."""
    assert PROGRAM["stale_gallery"]() == []


@pytest.mark.full
def test_the_notebook_shows_what_it_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs, and numbers and pictures are those of the committed notebook."""
    pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("nbformat", reason="nbformat is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    monkeypatch.setenv("PYTHONPATH", "")  # set by the script for its kernel, and again as it was afterwards
    assert PROGRAM["stale_notebook"](tmp_path) == []
