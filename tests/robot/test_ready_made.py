"""Descriptions of the package robot_descriptions by name.

A package of that form stands in its place, for the real one downloads.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from support.robots.robot_files import MJCF, URDF

from flexjoint.core.errors import RobotError
from flexjoint.robot import robot
from flexjoint.robot.draft import draft


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of the same layout: names in DESCRIPTIONS, one module each with URDF_PATH or MJCF_PATH."""
    root = tmp_path / "site" / "robot_descriptions"
    root.mkdir(parents=True)
    (tmp_path / "arm2.urdf").write_text(URDF)
    (tmp_path / "arm2.xml").write_text(MJCF.format(free=""))
    names = ("arm_description", "arm_mj_description", "gone_description")
    (root / "__init__.py").write_text(f"DESCRIPTIONS = dict.fromkeys({names!r})")
    (root / "arm_description.py").write_text(
        f"print('Cloning...')\nREPOSITORY_PATH = PACKAGE_PATH = {str(tmp_path)!r}\n"
        f"URDF_PATH = {str(tmp_path / 'arm2.urdf')!r}"
    )
    (root / "arm_mj_description.py").write_text(f"MJCF_PATH = {str(tmp_path / 'arm2.xml')!r}")
    (root / "gone_description.py").write_text("raise OSError('no network\\nat all')")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    for name in [name for name in sys.modules if name.split(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    yield root
    for name in [name for name in sys.modules if name.split(".")[0] == "robot_descriptions"]:
        del sys.modules[name]


def test_a_name_is_a_robot_and_a_robot_file_names_it(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loaded = robot.load("arm_description", joints=["elbow"], stiffness=100.0, motor_inertia=0.1)
    assert loaded.joint_names == ("elbow",) and loaded.mass == pytest.approx(3.5)
    assert capsys.readouterr().out == ""  # what the package says of its downloads is no result
    out = tmp_path / "elsewhere" / "arm.yaml"
    loaded.write(out)
    assert "urdf: robot_descriptions://arm_description" in out.read_text()
    assert robot.load(out).joint("elbow").drive.K == 100.0
    assert robot.load("arm_mj_description").joint_names == ("shoulder", "elbow")


def test_a_draft_of_a_name(package: Path, tmp_path: Path) -> None:
    out = tmp_path / "arm.yaml"
    out.write_text(draft("arm_description", out).text)
    assert robot.load(out).name == "arm"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("arn_description", "has no 'arn_description' among its 3; did you mean arm_description"),
        ("gone_description", "cannot be downloaded: no network at all"),
    ],
)
def test_a_name_that_cannot_be_had_is_refused(package: Path, name: str, said: str) -> None:
    with pytest.raises(RobotError, match=said) as error:
        robot.load(name)
    assert "\n" not in str(error.value)


def test_without_the_package_it_is_said_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        RobotError, match=r"is not installed; install it with: pip install 'flexjoint\[robots\]'"
    ):
        robot.load("panda_description")
