"""Ready-made descriptions of the package robot_descriptions, by name: it downloads each at its first use."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import sys
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from flexjoint.core.errors import RobotError

SCHEME = "robot_descriptions://"  # before a name, in a robot file
ENDING = "_description"  # of all its names
NAME = re.compile(rf"[\w+]+{ENDING}")  # tiago++_mj_description is one


def is_name(source: str) -> bool:
    """Whether a text looks like a name of that package: ur5e_mj_description."""
    return NAME.fullmatch(source) is not None


def find(name: str) -> Path:
    """The URDF or MJCF of a name, which may be downloaded; RobotError where that cannot be done."""
    module = _module(name)
    if hasattr(module, "URDF_PATH"):
        return Path(module.URDF_PATH)
    if hasattr(module, "MJCF_PATH"):
        return Path(module.MJCF_PATH)
    try:  # a xacro, which robot_descriptions expands
        with contextlib.redirect_stdout(sys.stderr):
            from robot_descriptions._xacro import get_urdf_path

            return Path(get_urdf_path(module))
    except Exception as error:  # what xacro and its own dependencies raise
        line = " ".join(str(error).split())
        raise RobotError(f"{name} of robot_descriptions cannot be made a URDF: {line}") from None


def package_dirs(name: str) -> tuple[Path, ...]:
    """Folders of its meshes: its package and its repository, and those that they lie in."""
    module = _module(name)
    stated = [getattr(module, key, None) for key in ("PACKAGE_PATH", "REPOSITORY_PATH")]
    own = [Path(folder) for folder in stated if folder is not None]
    return tuple(dict.fromkeys([*(folder.parent for folder in own), *own]))


def _module(name: str) -> Any:
    if importlib.util.find_spec("robot_descriptions") is None:
        raise RobotError(
            f"{name} looks like a name of robot_descriptions, which is not installed; install it with:"
            " pip install 'flexjoint[robots]', or give the path of a URDF, MJCF or SDF"
        )
    try:
        from robot_descriptions import DESCRIPTIONS
    except ImportError:
        raise RobotError(
            f"{name}: expected robot_descriptions 1.16 or newer, got one that does not list its names; update"
            " it with: pip install -U 'flexjoint[robots]'"
        ) from None

    if name not in DESCRIPTIONS:
        near = get_close_matches(name, DESCRIPTIONS, n=3)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        raise RobotError(f"robot_descriptions has no {name!r} among its {len(DESCRIPTIONS)}{hint}")
    try:
        with contextlib.redirect_stdout(sys.stderr):  # where it says what it downloads
            return importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:  # git's, the network's, the disk's
        line = " ".join(str(error).split())[:200]
        raise RobotError(f"{name} of robot_descriptions cannot be downloaded: {line}") from None
