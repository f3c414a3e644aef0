"""`flexjoint robots`: the robots that come with flexjoint."""

from __future__ import annotations

import argparse
import textwrap

from flexjoint.core.errors import MissingExtraError
from flexjoint.robot.robot import Robot, load, shipped_robots

WIDTH = 110
MANY = 12  # joints; more are counted, not listed


def run(arguments: argparse.Namespace) -> None:
    """Print the robots that come with flexjoint."""
    for name, path in shipped_robots().items():
        try:
            robot = load(path)
        except MissingExtraError as missing:
            print(f"{name}: {missing}\n    {path}")
            continue
        recordings = sorted((path.parent / "recordings").glob("*.parquet"))
        base = ", floating base" if robot.floating else ""
        joints = (
            ", ".join(robot.joint_names)
            if len(robot.joints) <= MANY
            else f"{len(robot.joints)} joints{base}, {robot.mass:.4g} kg"
        )
        kept = f"; recordings {', '.join(r.stem for r in recordings)}" if recordings else ""
        print(f"{name}: {joints}{kept}")
        for head, names in (
            ("sections", _sections(robot)),
            ("presets", list(robot.file.presets)),
            ("poses", list(robot.poses) if robot.file.poses else []),
        ):
            if names:
                text = f"{head}: {', '.join(names)}"
                print(textwrap.fill(text, WIDTH, initial_indent="    ", subsequent_indent="        "))
        assumed = [key for key, text in robot.file.sources.items() if "ASSUMPTION" in str(text)]
        if assumed:
            print(f"    assumed (see sources in the file): {', '.join(assumed)}")
        print(f"    {path}")


def _sections(robot: Robot) -> list[str]:
    return [
        f"{name} ({', '.join(section.parts)})" if section.parts else name
        for name, section in robot.file.sections.items()
    ]
