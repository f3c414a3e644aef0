"""Notebooks run from top to bottom, and are stored without what running them leaves behind."""

from __future__ import annotations

import html
import os
import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from support import browsers
from support.thorough import thorough

from flexjoint.report.view.browser import opened

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
WORDS_AWAY = "for (const id of ['head', 'player', 'labels']) document.getElementById(id).style.opacity = 0"
DIAGNOSES = "what_does_my_simulation_get_wrong"  # for minutes, as it is about a robot of six joints
WHOLE_ROBOT = "centauro"  # simulated for a minute
QUICK = "theta_d_offline"  # the one that `make test` runs
every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks() -> None:
    told = {
        WHOLE_ROBOT,
        "effect_of_stiffness",
        "gain_design",
        QUICK,
        DIAGNOSES,
    }
    assert {path.stem for path in NOTEBOOKS} == told


@every_notebook
def test_a_notebook_is_stored_clean(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
    assert path.stat().st_size < 1e6


@every_notebook
def test_pictures_and_links_of_a_notebook_lead_somewhere(path: Path) -> None:
    words = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]
    for target in re.findall(r"\]\(([^)]+)\)", "\n".join(words)):
        assert target.startswith("http") or (path.parent / target).exists(), target


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=() if p.stem == QUICK else thorough) for p in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_a_notebook_runs_and_draws(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, with this checkout's package. Minutes are far more than it takes."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook, timeout=1200, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 4
    assert not [output.text for output in outputs if output.get("name") == "stderr"]
    if path.stem == "centauro":
        shown = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
        look(shown)


def look(shown: list[str]) -> None:
    """The views of a notebook, where a browser is there: sections, poses, and the move, which moves."""
    assert len(shown) == 3
    assert all(len(view) < 8e6 for view in shown)
    if not browsers.there():
        return
    for view in shown:
        (page,) = re.findall(r'<iframe srcdoc="(.*?)"', view, re.DOTALL)
        with opened(html.unescape(page), (480, 320)) as browser:
            browser.evaluate(WORDS_AWAY)
            first = browsers.pixels(browser.frame(0))
            dark = np.count_nonzero(np.max(first, axis=2) < 60)
            assert dark > 500  # of CENTAURO, which is black; 0 without it, for ground and sky are light
            if view is shown[-1]:
                later = browsers.pixels(browser.frame(150))  # after 50 s, in the mammal pose
                assert np.count_nonzero(browsers.changed(first, later)) > 1500
