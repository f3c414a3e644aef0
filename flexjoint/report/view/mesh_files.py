"""How many triangles a mesh's file holds, counted without reading it as a mesh: time and memory grow with
these rather than with bytes, of which a triangle takes 6 or 200."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

HEADER, FACE = 84, 50  # bytes of a binary STL, and of each of its triangles
DENSEST = 12  # bytes of a triangle in a format that is not known: three indices of four bytes
FEWEST = 6  # and in any: "1 1 1 "

_PRIMITIVE = re.compile(rb"<(triangles|polylist|polygons|trifans|tristrips)\b(.*?)</\1\s*>", re.DOTALL)
_PLACES = re.compile(rb"<p\b[^>]*>(.*?)</p\s*>", re.DOTALL)
_SIDES = re.compile(rb"<vcount\b[^>]*>(.*?)</vcount\s*>", re.DOTALL)
_OFFSET = re.compile(rb"""\boffset\s*=\s*["'](\d{1,3})["']""")


def triangles_in(path: Path, enough: int) -> int:
    """Triangles of an STL, OBJ or Collada file, polygons in as many as they are cut into; of another format
    as many as fit in. A file that is too small for `enough` of them is not opened."""
    size = path.stat().st_size
    if size <= FEWEST * enough:
        return 0
    count = {".stl": _stl, ".obj": _obj, ".dae": _collada}.get(path.suffix.lower())
    return size // DENSEST if count is None else count(path)


def _stl(path: Path) -> int:
    data = path.read_bytes()
    stated = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    if len(data) == HEADER + FACE * stated:
        return stated
    return max(data.count(b"endfacet"), (len(data) - HEADER) // FACE if b"\0" in data else 0)


def _obj(path: Path) -> int:
    with path.open("rb") as file:
        return sum(max(0, len(line.split()) - 3) for line in file if line.lstrip()[:2].split() == [b"f"])


def _collada(path: Path) -> int:
    total = 0
    for kind, text in _PRIMITIVE.findall(path.read_bytes()):
        places = _PLACES.findall(text)
        inputs = 1 + max((int(offset) for offset in _OFFSET.findall(text)), default=0)
        corners = sum(_words(one) for one in places) // inputs
        sides = _SIDES.findall(text)
        faces = sum(_words(one) for one in sides) if sides else len(places)
        total += corners // 3 if kind == b"triangles" else max(0, corners - 2 * faces)
    return total


def _words(text: bytes) -> int:
    """What white space separates."""
    letters = np.concatenate([[False], np.frombuffer(text, dtype=np.uint8) > ord(" ")])
    return int(np.count_nonzero(letters[1:] & ~letters[:-1]))
