"""What works, and what is said, where the package of ready-made descriptions is not installed."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import pytest
import yaml

from flexjoint.cli.main import main
from flexjoint.core.errors import MissingExtraError
from flexjoint.robot.description import EXAMPLES
from flexjoint.robot.robot import load, robots_folder

WANTED = "example-robot-data is not installed; install it with: pip install 'flexjoint[example-robots]'"


@pytest.fixture(autouse=True)
def not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = importlib.metadata.distribution

    def distribution(name: str) -> importlib.metadata.Distribution:
        if name == EXAMPLES:
            raise importlib.metadata.PackageNotFoundError(name)
        return usual(name)

    monkeypatch.setattr(importlib.metadata, "distribution", distribution)


@pytest.mark.parametrize("name", ["ur5", "panda", "talos_arm", "centauro"])
def test_its_robots_say_what_to_install(name: str) -> None:
    with pytest.raises(MissingExtraError) as error:
        load(name)
    assert str(error.value) == WANTED


def test_the_command_line_says_it_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "--robot", "ur5"]) == 2
    assert capsys.readouterr().err == f"flexjoint: {WANTED}\n"


def test_the_list_of_robots_names_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    printed = capsys.readouterr().out
    assert f"centauro: {WANTED}" in printed and "kr300: " in printed and printed.count(WANTED) == 4


def test_other_robots_and_own_packages_need_nothing_of_it(tmp_path: Path) -> None:
    assert load("kr300").joint_names and load("tx40").joint_names
    rrbot = robots_folder() / "rrbot"
    raw = yaml.safe_load((rrbot / "rrbot.yaml").read_text())
    (tmp_path / "share" / "arm").mkdir(parents=True)
    (tmp_path / "share" / "arm" / "arm.urdf").write_text((rrbot / raw["urdf"]).read_text())
    raw |= {"urdf": "package://arm/arm.urdf", "package_dirs": ["share"]}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(raw))
    assert load(tmp_path / "own.yaml").joint_names == load("rrbot").joint_names
