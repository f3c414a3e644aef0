"""Descriptions of the package robot_descriptions by name.

A package of that form stands in its place, for the real one downloads.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from support.robots.robot_files import MJCF, URDF

from flexjoint.cli.main import main
from flexjoint.core.errors import RobotError
from flexjoint.robot import robot
from flexjoint.robot.draft import draft
from flexjoint.robot.ready_made import package_dirs

XACRO = """
def get_urdf_path(module):
    print("expanding", module.XACRO_PATH)
    if module.__name__.endswith("lone_xacro_description"):
        raise ModuleNotFoundError("This robot description requires 'xacrodoc'.")
    return {urdf!r}
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of the same layout: names in DESCRIPTIONS, one module each with URDF_PATH or MJCF_PATH."""
    root = tmp_path / "site" / "robot_descriptions"
    root.mkdir(parents=True)
    (tmp_path / "arm2.urdf").write_text(URDF)
    (tmp_path / "arm2.xml").write_text(MJCF.format(free=""))
    names = (
        "arm_description",
        "arm_mj_description",
        "arm++_description",
        "arm_xacro_description",
        "lone_xacro_description",
        "gone_description",
    )
    (root / "__init__.py").write_text(f"DESCRIPTIONS = dict.fromkeys({names!r})")
    (root / "arm_description.py").write_text(
        f"print('Cloning...')\nREPOSITORY_PATH = PACKAGE_PATH = {str(tmp_path)!r}\n"
        f"URDF_PATH = {str(tmp_path / 'arm2.urdf')!r}"
    )
    (root / "arm_mj_description.py").write_text(f"MJCF_PATH = {str(tmp_path / 'arm2.xml')!r}")
    (root / "arm++_description.py").write_text((root / "arm_description.py").read_text())
    for name in ("arm_xacro", "lone_xacro"):
        (root / f"{name}_description.py").write_text("XACRO_PATH = 'arm.urdf.xacro'")
    (root / "_xacro.py").write_text(XACRO.format(urdf=str(tmp_path / "arm2.urdf")))
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
    for name in ("arm++_description", "arm_xacro_description"):
        assert robot.load(name).joint_names == robot.load("arm_description").joint_names
    assert capsys.readouterr().out == ""


def test_meshes_are_looked_up_in_its_package_and_beside_it(package: Path, tmp_path: Path) -> None:
    assert package_dirs("arm_description") == (tmp_path.parent, tmp_path)
    assert package_dirs("arm_mj_description") == ()


def test_a_draft_of_a_name(package: Path, tmp_path: Path) -> None:
    out = tmp_path / "arm.yaml"
    out.write_text(draft("arm_description", out).text)
    assert robot.load(out).name == "arm"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("arn_description", "has no 'arn_description' among its 6; did you mean arm_description"),
        ("gone_description", "cannot be downloaded: no network at all"),
        ("lone_xacro_description", "cannot be made a URDF: This robot description requires 'xacrodoc'"),
    ],
)
def test_a_name_that_cannot_be_had_is_refused(package: Path, name: str, said: str) -> None:
    with pytest.raises(RobotError, match=said) as error:
        robot.load(name)
    assert "\n" not in str(error.value)


def test_a_package_that_does_not_list_its_names_is_too_old(package: Path) -> None:
    (package / "__init__.py").write_text("__version__ = '1.15.0'")
    with pytest.raises(RobotError, match=r"expected robot_descriptions 1\.16 or newer.*pip install -U"):
        robot.load("arm_description")


def test_the_command_says_so_in_one_line(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", "arm_description", "--out", str(tmp_path / "arm.yaml")]) == 0
    assert "3 joints" in capsys.readouterr().out
    for name in ("gone_description", "arn_description"):
        assert main(["init", name, "--out", str(tmp_path / "other.yaml")]) == 2
        assert [line for line in capsys.readouterr().err.splitlines() if "flexjoint" in line][1:] == []


def test_without_the_package_it_is_said_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        RobotError, match=r"is not installed; install it with: pip install 'flexjoint\[robots\]'"
    ):
        robot.load("panda_description")
