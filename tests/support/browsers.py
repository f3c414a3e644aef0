"""A headless browser for tests, and what is in its pictures."""

from __future__ import annotations

import io
import os

import numpy as np
import pytest
from PIL import Image

from flexjoint.report.view.browser import NoBrowserError, find

REQUIRED = "FLEXJOINT_BROWSER_TESTS"


def need_browser() -> None:
    """Skip where no browser is installed, unless the environment says that it is required."""
    if missing := why_none():
        pytest.skip(missing)


def there() -> bool:
    """Whether a browser is installed; fails where the environment says that it is required."""
    return not why_none()


def why_none() -> str:
    try:
        find()
    except NoBrowserError as error:
        if os.environ.get(REQUIRED) == "required":
            pytest.fail(f"{REQUIRED}=required, but: {error}")
        return str(error)
    return ""


def pixels(png: bytes) -> np.ndarray:
    """(h, w, 3) of 0 to 255."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def changed(before: np.ndarray, after: np.ndarray, by: int = 24) -> np.ndarray:
    """(h, w) where a channel differs by more than `by`, which shading of the ground alone does not."""
    return np.max(np.abs(after - before), axis=2) > by


def near(picture: np.ndarray, colour: tuple[int, int, int], by: int = 70) -> int:
    """Number of pixels of about that colour."""
    return int(np.count_nonzero(np.max(np.abs(picture - np.array(colour)), axis=2) < by))
