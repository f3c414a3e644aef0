"""The documentation as a site: every page has its place, every name and command its entry, every link leads
somewhere."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study import smallest
from support.pages import DOCS, ROOT
from support.thorough import thorough

import flexjoint as fj

BUILD = DOCS / "site" / "build.py"


@pytest.fixture(scope="module")
def build() -> dict[str, Any]:
    return runpy.run_path(str(BUILD))


def test_every_public_name_is_in_the_reference(build: dict[str, Any]) -> None:
    page = build["api"]()
    assert [name for name in fj.__all__ if f"flexjoint.{name}\n" not in page] == []


def test_every_command_is_in_the_reference(build: dict[str, Any]) -> None:
    page = build["cli"]()
    for command in ("diagnose", "compare", "import", "benchmark make", "paper whole-body"):
        assert f" flexjoint {command}\n" in page
    assert page.count("usage: flexjoint") > 15


def test_every_page_is_in_one_table_of_contents(build: dict[str, Any], tmp_path: Path) -> None:
    for name in ("gallery", "api", "cli"):
        (tmp_path / f"{name}.md").touch()
    for pattern in build["PAGES"]:
        for path in ROOT.glob(pattern):
            if path.suffix in (".md", ".ipynb"):
                copy = tmp_path / path.relative_to(ROOT)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.touch()
    listed = [
        line for tree in build["trees"](tmp_path) for line in tree.splitlines() if line and line[0] != ":"
    ]
    there = {p.relative_to(tmp_path).with_suffix("").as_posix() for p in tmp_path.rglob("*") if p.is_file()}
    assert sorted(listed) == sorted(there)


def test_the_gallery_tells_each_effect_s_law_size_and_fate(tmp_path: Path) -> None:
    gallery = runpy.run_path(str(DOCS / "site" / "gallery.py"))
    effect = fj.catalogue()["backlash"]
    card = gallery["_card"](effect, tmp_path)
    assert effect.law in card and "Here: gap 0.00" in card and "In the study it was named" in card
    assert "Smallest that was found" in card and "on the lever (1/" in card
    (picture,) = tmp_path.iterdir()
    assert f"gallery_pictures/{picture.name}" in card and picture.stat().st_size < 200_000
    drawn = picture.stat().st_mtime_ns
    gallery["_card"](effect, tmp_path)
    assert picture.stat().st_mtime_ns == drawn  # kept, as nothing changed
    assert "On real machines: gap 6e-05 rad stated of the kr300." in card
    assert effect.typical and gallery["typical_sizes"](fj.catalogue()["end_stop"]) == ""
    for one in effect.typical:
        assert f"{one.size} ([{one.source.name}]({one.source.address}))" in card
    assert "No other effect is the same" in card and "Named in its place: " in card
    found = gallery["_real"](fj.catalogue()["sensor_delay"])
    assert found == ["On real machines: delay 0.00305 s found on the kr300."]
    tied = gallery["_alike"](fj.catalogue()["payload"])
    assert tied == ["The same to any experiment as `base_tilt` ([ties](docs/explained/diagnosis.md#ties))."]


@thorough
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """Every warning is an error: links, references, docstrings."""
    pytest.importorskip("sphinx")
    command = [sys.executable, str(BUILD), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    html = (tmp_path / "html" / "gallery.html").read_text(encoding="utf-8")
    assert html.count("<img ") >= sum(e.is_cause for e in fj.catalogue().values())


def test_the_smallest_sizes_are_of_effects_that_there_are() -> None:
    table = json.loads((DOCS / "site" / "smallest_sizes.json").read_text(encoding="utf-8"))
    known = set(smallest.pairs())
    rows = [(row["effect"], row["robot"]) for row in table["rows"]]
    assert len(set(rows)) == len(rows) and set(rows) <= known and table["version"]
    for row in table["rows"]:
        assert row["effect"] in fj.catalogue() and (row["found"] or row["missed"])
        if row["found"]:
            assert np.log2(row["found"]["size"]) in range(-smallest.HALVINGS, 1)
