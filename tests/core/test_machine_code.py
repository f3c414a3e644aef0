"""Loops compiled to machine code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from flexjoint.core.compiled import compiled


def total(x: np.ndarray, factor: float) -> float:
    """Grows with rounding, so that another order of its operations would show."""
    out = 0.0
    for value in x:
        out = out * factor + value * 1e-3
    return out


def test_compiled_code_gives_the_same_bits() -> None:
    x = np.random.default_rng(1).normal(size=10_000)

    assert compiled(total)(x, 0.97) == total(x, 0.97)


def test_it_compiles_where_nothing_can_be_kept(tmp_path: Path) -> None:
    """A package that is read from an archive has no folder to which anything can be written."""
    code = (
        "import sys, zipfile\n"
        "with zipfile.ZipFile('loops.zip', 'w') as archive:\n"
        "    archive.writestr('loops.py', 'def twice(x):\\n    return 2.0 * x\\n')\n"
        "sys.path.insert(0, 'loops.zip')\n"
        "import loops\n"
        "from flexjoint.core.compiled import compiled\n"
        "print(compiled(loops.twice)(1.5))\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )

    assert done.stdout.strip() == "3.0", done.stderr
