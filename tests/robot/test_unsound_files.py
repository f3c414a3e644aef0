"""Robot files that lie or want too much: refused in words, before any work grows with them."""

# ruff: noqa: E501  (tables of what was changed, one case a line)
from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import pytest
from support.robots.robot_files import JOINT, file

from flexjoint.core.errors import RobotError
from flexjoint.core.limits import ROBOT_FILE
from flexjoint.core.messages import LONGEST_LINE, one_line
from flexjoint.robot import robot

LISTS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefghi", "bcdefghij", strict=True)
)  # 9^10 values in 500 bytes


def refused(path: Path, said: str) -> None:
    with pytest.raises(RobotError) as error:
        robot.load(path)
    line = one_line(error.value)
    assert said in line and len(line) <= LONGEST_LINE, line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LISTS, "more than 20000 values, aliases counted as what they stand for"),
        ("name: &a [*a]\n", "alias *a stands within what it names"),
        ("joints: &a {b: *a}\n", "alias *a stands within what it names"),
        ("a: " + "[" * 5000 + "]" * 5000, "more than 30 levels of nesting"),
        ("{a: " * 500 + "1" + "}" * 500, "more than 30 levels of nesting"),
        ("[" + "1," * 30_000 + "]", "more than 20000 values"),
        ("name: a\nurdf: b\nname: c\n", "key 'name' stands twice in line 3; keep one"),
        (
            "joints: {elbow: {stiffness: 1:30}}",
            "line 1: '1:30' would be read as an octal, hexadecimal or sexa",
        ),
        ("joints: {elbow: {stiffness: 010}}", "'010' would be read as"),
        ("joints: {elbow: {stiffness: 1_0.5}}", "'1_0.5' would be read as"),
        ("name: " + "9" * 100_000, "is not valid YAML: Exceeds the limit"),
        (
            "name: [" + "a" * 500_000 + "]\njoints: {elbow: {}}\nurdf: b",
            "Input should be a valid string, got ['aaa",
        ),
        ("x" * (ROBOT_FILE.file_bytes + 1), "has more than 1000000 bytes"),
        ('name: "a\\e[31m"', r"name: 'a\x1b[31m' holds control characters; rename it"),
        ('"\\e[31mred": 1', r"'\x1b[31mred' holds control characters"),
        ('name: a\nlock: ["wr\\u202eist"]', r"lock.0: 'wr\u202eist' holds control characters"),
        ('!!python/object/apply:os.system ["true"]', "is not valid YAML: could not determine a constructor"),
    ],
    ids=range(17),
)
def test_a_file_that_wants_too_much_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "r.yaml"
    path.write_text(text)
    refused(path, said)


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (1e20, "1e+20 is beyond 1e+12"),
        (1e300, "1e+300 is beyond 1e+12"),
        ("1e20", "1e+20 is beyond 1e+12"),  # without a point it is a text to YAML, and a number to the schema
        (10**400, "is beyond 1e+12"),
        (1e-20, "1e-20 is below 1e-09"),
        (math.nan, "expected a number, got .nan"),
        (True, "expected a number or a name, got true"),
        ("1,5", "unable to parse string as a number, got '1,5'"),
    ],
    ids=str,
)
@pytest.mark.parametrize("key", ["stiffness", "motor_inertia", "torque_limit"])
def test_a_number_that_no_joint_has_is_refused(tmp_path: Path, key: str, number: Any, said: str) -> None:
    path = file(tmp_path, joints={"elbow": {**JOINT, key: number}})
    refused(path, f"joints.elbow.{key}: ")
    refused(path, said)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rates": {"control": 1e-9}}, "rates.control: Input should be greater than or equal to 1"),
        ({"gravity": [0, 0, math.nan]}, "gravity.2: expected a number, got .nan"),
        ({"initial": {"elbow": 1e20}}, "initial.elbow: 1e+20 is beyond"),
        ({"joints": {"elbow": {**JOINT, "resolution": {"q": -1}}}}, "resolution.q: Input should be greater than"),
        ({"joints": {"elbow": {**JOINT, "controller": {"name": "pd", "kp": math.nan}}}}, "kp: expected a number"),
        ({"effects": [{"effect": "backlash", "joint": "elbow", "gap": 1e300}]}, "effects.0.gap: 1e+300 is beyond"),
        ({"urdf": "package://../../arm2.urdf", "package_dirs": ["."]}, "leaves its package; name a place below it"),
    ],
    ids=range(7),
)  # fmt: skip
def test_a_value_that_no_robot_has_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    refused(file(tmp_path, **changes), said)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "r.yaml")
    refused(tmp_path / "r.yaml", "is no file but a pipe or device; give a file")


@pytest.mark.parametrize(
    ("name", "leaves"),
    [
        ("package://arm/arm2.urdf", False),
        ("package://arm/../arm2/arm2.urdf", False),  # beside it, below the same folder
        ("package://../arm2.urdf", True),
        ("package://arm/../../arm2.urdf", True),
        ("package:///../x.stl", True),
        ("package://arm\\..\\..\\x.stl", True),
    ],
)
def test_a_name_that_climbs_out_of_its_package_is_seen(name: str, leaves: bool) -> None:
    assert robot.robot_description.leaves_package(name) is leaves
