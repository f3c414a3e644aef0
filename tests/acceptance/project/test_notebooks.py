"""Notebooks run from top to bottom, and are stored without what running them leaves behind."""

from __future__ import annotations

import base64
import html
import json
import os
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from queue import Empty
from typing import Any

import nbformat
import numpy as np
import pytest
from jupyter_client.channels import AsyncZMQSocketChannel
from nbclient import NotebookClient
from support import browsers
from support.thorough import thorough

import flexjoint
from flexjoint.report.view.browser import opened
from flexjoint.robot import robot

ROOT = Path(__file__).parents[3]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
WORDS_AWAY = "for (const id of ['head', 'player', 'labels']) document.getElementById(id).style.opacity = 0"
WHOLE_ROBOT = "07_centauro"  # simulated for a minute
QUICK = ("04_theta_d_offline", "09_symbolic_model")  # those that `make test` runs
OWN_PICTURES = ("03_effect_of_stiffness", WHOLE_ROBOT)  # these draw what they keep by themselves
PICTURES = "FLEXJOINT_PICTURES"
MOST = 180.0  # seconds of a processor that a notebook may take, its worker processes included
HANGS = 1200  # seconds from which a cell hangs, however busy the machine
LOOKS = 5.0  # seconds after which the kernel's socket is looked at again
SPENT = "import os; print(sum(os.times()[:4]))"
Get = Callable[[AsyncZMQSocketChannel, float | None], Awaitable[Any]]  # a message, within so many seconds
every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "01_what_does_my_simulation_get_wrong",
        "02_my_own_robot",
        "03_effect_of_stiffness",
        "04_theta_d_offline",
        "05_gain_design",
        "06_the_paper",
        "07_centauro",
        "08_an_effect_of_your_own",
        "09_symbolic_model",
    ]


def test_the_stored_diagnosis_is_one_of_the_stored_robot() -> None:
    """What the first notebook reads instead of diagnosing for minutes."""
    folder = robot.robots_folder() / "kr300" / "diagnosed"
    said = json.loads((folder / "rec_A.json").read_text(encoding="utf-8"))
    extended = robot.load(folder / said["model"])
    added = set(map(str, extended.effects)) - set(map(str, robot.load("kr300").effects))
    assert {name.split(" on ")[0] for name in added} <= {f["effect"] for f in said["findings"]}
    assert len(added) >= 3 and {entry["joint"] for entry in said["remaining"]} == set(extended.joint_names)


@every_notebook
def test_a_notebook_is_stored_clean(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
    assert path.stat().st_size < 1e6


@every_notebook
def test_a_notebook_uses_public_names_alone(path: Path) -> None:
    """But for the one that writes an effect, which is a part of the package."""
    if path.stem == "08_an_effect_of_your_own":
        return
    code = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    inside = re.findall(r"(?:from|import) flexjoint\.[\w.]+", "\n".join(code))
    taken = re.findall(r"from flexjoint import \(?([^)\n]+(?:\n +[^)]+)?)", "\n".join(code))
    names = {name.strip() for line in taken for name in line.split(",") if name.strip()}
    used = set(re.findall(r"\bfj\.(\w+)", "\n".join(code)))
    assert inside == [] and names | used <= set(flexjoint.__all__)


@every_notebook
def test_pictures_and_links_of_a_notebook_lead_somewhere(path: Path) -> None:
    words = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]
    for target in re.findall(r"\]\(([^)]+)\)", "\n".join(words)):
        assert target.startswith("http") or (path.parent / target).exists(), target


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=() if p.stem in QUICK else thorough) for p in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_a_notebook_runs_and_draws(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder, with this checkout's package, within three minutes of a processor: that is no more
    on a machine which others use."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setattr(AsyncZMQSocketChannel, "get_msg", looking_again)
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(SPENT))
    NotebookClient(
        notebook, timeout=HANGS, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    seconds = float(notebook.cells.pop().outputs[0].text)
    assert seconds < MOST, f"{path.stem} takes {seconds:.0f} s of a processor, expected at most {MOST:g} s"
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 2
    if PICTURES in os.environ and path.stem not in OWN_PICTURES:
        (kept,) = re.findall(rf"pictures/{path.stem}_(\d+)\.png", path.read_text(encoding="utf-8"))
        picture = base64.b64decode(pictures[int(kept)]["data"]["image/png"])
        (Path(os.environ[PICTURES]) / f"{path.stem}_{kept}.png").write_bytes(picture)
    assert not [output.text for output in outputs if output.get("name") == "stderr"]
    if path.stem == WHOLE_ROBOT:
        shown = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
        look(shown)


async def looking_again(
    channel: AsyncZMQSocketChannel, timeout: float | None = None, get: Get = AsyncZMQSocketChannel.get_msg
) -> Any:
    """A kernel's next message, as the client gets it, but in short waits. pyzmq may miss that a message has
    come, and finds it when a wait is over: a notebook of half a minute had stood for all of `HANGS`."""
    left = np.inf if timeout is None else timeout
    while left > LOOKS:
        try:
            return await get(channel, LOOKS)
        except Empty:
            left -= LOOKS
    return await get(channel, left)


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
