"""Who may import whom is written in pyproject.toml, and covers every package; `make lint` keeps it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
LAYERS = [contract for contract in CONTRACTS["contracts"] if contract["type"] == "layers"]


@pytest.mark.parametrize("contract", LAYERS, ids=lambda contract: contract["containers"][0])
def test_every_package_has_its_floor(contract: dict[str, Any]) -> None:
    """A file beside the packages has none, so that it would break the contract."""
    (container,) = contract["containers"]
    folder = ROOT.joinpath(*container.split("."))
    inside = {
        path.stem for path in folder.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    floors = [name.strip() for layer in contract["layers"] for name in layer.split("|")]
    needed = {name for name in floors if not name.startswith("(")}
    optional = {name.strip("()") for name in floors} - needed
    assert needed <= inside - {"__init__"} <= needed | optional
    assert contract["exhaustive"] is True


def test_the_first_folder_has_fourteen_entries_at_most() -> None:
    """Who is new finds the room for a change by its name alone."""
    entries = {
        path.name for path in (ROOT / "flexjoint").iterdir() if path.name not in ("__pycache__", "shipped")
    }
    assert len(entries) <= 14, sorted(entries)


def test_nothing_is_let_through() -> None:
    assert not CONTRACTS.get("exclude_type_checking_imports", False)
    for contract in CONTRACTS["contracts"]:
        assert "ignore_imports" not in contract and "exhaustive_ignores" not in contract
    assert "lint-imports" in (ROOT / "Makefile").read_text(encoding="utf-8")
