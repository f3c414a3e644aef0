"""A folder in which no file can be made, whoever asks."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

KERNELS = Path("/sys/kernel")  # in which not even root may make a file


def locked(folder: Path) -> Path:
    """This folder, made without permission to write; for root, who needs none, one of the kernel's."""
    if os.geteuid() != 0:
        folder.mkdir(mode=0o500)
        return folder
    if not KERNELS.is_dir():
        pytest.skip("root may write everywhere, but in what the Linux kernel makes")
    return KERNELS
