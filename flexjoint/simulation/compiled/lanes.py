"""Generated C whose numbers are lanes, each of another rollout (sources/lanes.c), and arrays for it."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

ALIGNED = 64  # bytes: the largest register
_OPERATORS = {"<": "lt", "<=": "le", "==": "eq", "!=": "ne", "&&": "and", "||": "or"}
_FUNCTION = re.compile(r"^/\* (\w+):.*?\*/\n(static int (\w+)\(.*?^\}\n)", re.MULTILINE | re.DOTALL)
_TURNED = re.compile(r"^  (\w+)=(sin|cos)\((\w+)\);$")
_REPLACED = (
    (re.compile(r"=(-?(?:[\d.][\w.+-]*|casadi_inf|INFINITY));"), r"=fj_all(\1);"),
    (re.compile(r"=\(!(\w+)\);"), r"=fj_not(\1);"),
    (re.compile(r"=\((\w+)\?(\w+):0\);"), r"=fj_if(\1,\2);"),
    (re.compile(r"=(?:casadi_)?([a-z]\w*)\("), r"=fj_\1("),
)
_BINARY = re.compile(r"=\((\w+)(<=|<|==|!=|&&|\|\|)(\w+)\);")


def laned(source: str) -> str:
    """The functions of a source of `unguarded` in the numbers of lanes.c, without all that stands around
    them. Each line of CasADi's is one operation."""
    parts = ["#define casadi_int long long int\n#define casadi_inf INFINITY\n"]
    names = []
    for name, body, own in _FUNCTION.findall(source):
        lines = [_line(line) for line in _turned_once(body.splitlines())]
        parts.append("\n".join(lines) + "\n")
        names.append(f"#define {name} {own}\n")
    return "".join(parts + names)


def _line(line: str) -> str:
    for pattern, replacement in _REPLACED:
        line, replaced = pattern.subn(replacement, line)
        if replaced:
            return line
    return _BINARY.sub(lambda found: f"=fj_{_OPERATORS[found[2]]}({found[1]},{found[3]});", line)


def _turned_once(lines: Sequence[str]) -> list[str]:
    """The lines with sine and cosine of one number from one call."""
    written: Counter[str] = Counter()
    keys: list[tuple[str, int] | None] = []  # the argument and how often it had been written
    for line in lines:
        found = _TURNED.match(line)
        keys.append((found[3], written[found[3]]) if found else None)
        if assigned := re.match(r"  (\w+) ?=", line):
            written[assigned[1]] += 1
    count = Counter(keys)
    places: dict[tuple[str, int], int] = {}
    out = []
    for line, key in zip(lines, keys, strict=True):
        found = _TURNED.match(line)
        if found and key and count[key] > 1:
            if key not in places:
                k = places[key] = len(places)
                out.append(f"  fj_real sin{k}, cos{k}; fj_sincos({key[0]}, &sin{k}, &cos{k});")
            out.append(f"  {found[1]}={found[2]}{places[key]};")
        else:
            out.append(line)
    return out


def aligned(*shape: int) -> np.ndarray:
    """An array (..., lanes) that is not set, at an address that every register takes."""
    if shape[-1] == 1:  # doubles lie anywhere, and this is quicker
        return np.empty(shape)
    size = 8 * math.prod(shape)
    raw = np.empty(size + ALIGNED, np.uint8)
    begin = -raw.ctypes.data % ALIGNED
    return raw[begin : begin + size].view(float).reshape(shape)


def side_by_side(rows: Sequence[np.ndarray], lanes: int) -> np.ndarray:
    """(..., lanes) of arrays of equal shape, one for each lane; the last one fills those that are left."""
    if lanes == 1:
        return np.ascontiguousarray(rows[0], dtype=float)[..., np.newaxis]
    out = aligned(*rows[0].shape, lanes)
    for lane in range(lanes):
        out[..., lane] = rows[min(lane, len(rows) - 1)]
    return out
