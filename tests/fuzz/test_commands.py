"""The main commands with robots, recordings and options that are drawn: exit code 0 or 2, one line, no traceback,
no half-written file, no endless work."""

# ruff: noqa: E501
from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fuzz.hostile import command, fuzz
from hypothesis import given
from hypothesis import strategies as st
from support.robots.robot_files import JOINT, URDF, content

from flexjoint.effects import catalogue
from flexjoint.recording import table as recording
from flexjoint.recording.table import UNITS, Recording

JOINTS = ("shoulder", "elbow")
ROWS = 120

numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(1e-3, 1e4),
    st.sampled_from([0, -1, 1e-12, 1e-9, 1e9, 1e12, 1e300, 10**30, True, None, "1,5", "1e3", "x", [], {}]),
)
names = st.one_of(st.sampled_from([*JOINTS, "wrist", "nope", ""]), st.text(max_size=8))
joints = st.fixed_dictionaries(
    {key: st.just(value) for key, value in JOINT.items()},
    optional={key: numbers for key in ("kp", "kd", "gear_ratio", "torque_constant")},
).flatmap(
    lambda usual: st.dictionaries(st.sampled_from([*JOINT, "kp", "nope"]), numbers, max_size=2).map(
        lambda changes: {**usual, **changes}
    )
)
effects = st.builds(
    lambda name, joint, values: {"effect": name, "joint": joint, **values},
    st.sampled_from([*sorted(catalogue()), "nope"]),
    names,
    st.dictionaries(
        st.sampled_from(sorted({p.name for e in catalogue().values() for p in e.params})), numbers, max_size=3
    ),
)
changes = st.fixed_dictionaries(
    {},
    optional={
        "joints": st.dictionaries(names, joints, max_size=3),
        "effects": st.lists(effects, max_size=2),
        "rates": st.dictionaries(
            st.sampled_from(["physics", "control"]),
            st.one_of(numbers, st.sampled_from([100, 250, 500.0, 999.7, 1000])),
        ),
        "gravity": st.one_of(numbers, st.lists(numbers, min_size=2, max_size=4)),
        "tolerance": st.dictionaries(st.sampled_from(["inertial", "torque", "nope"]), numbers),
        "lock": st.one_of(numbers, st.lists(names, max_size=3)),
        "initial": st.dictionaries(names, numbers, max_size=2),
        "sensing_delay": numbers,
        "base": st.sampled_from(["fixed", "floating", "nope", 1]),
        "offsets": st.sampled_from(["per_recording", None, "x"]),
        "poses": st.dictionaries(names, st.dictionaries(names, numbers, max_size=2), max_size=2),
        "continuous": st.lists(names, max_size=2),
        "contacts": st.lists(
            st.fixed_dictionaries({"frame": names}, optional={"radius": numbers, "rolls": names}), max_size=2
        ),
        "controller": numbers,
        "urdf": st.sampled_from(["arm2.urdf", "nope.urdf", "", ".", "package://../x.urdf", "\0"]),
    },
)
columns = st.dictionaries(
    st.tuples(st.sampled_from(sorted(UNITS)), st.sampled_from([*JOINTS, "wrist"])),
    st.tuples(
        st.sampled_from([0.0, 1e-9, 0.01, 1.0, 30.0, 1e6, 1e9]),
        st.sampled_from(["wave", "still", "noise", "gaps", "steps"]),
    ),
    min_size=1,
    max_size=12,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a good robot and a good recording of it."""
    made = tmp_path_factory.mktemp("run")
    (made / "arm2.urdf").write_text(URDF)
    (made / "good.yaml").write_text(yaml.safe_dump(content(lock=["wrist"])))
    recording.write(
        drawn({(c, j): (0.2, "wave") for c in ("q", "theta", "tau_m") for j in JOINTS}), made / "good.csv"
    )
    return made


def drawn(given_columns: dict[tuple[str, str], tuple[float, str]]) -> Recording:
    """A recording of those sizes and shapes."""
    rng = np.random.default_rng(0)
    t = np.arange(ROWS) / 250.0
    shapes = {
        "wave": np.sin(9.0 * t),
        "still": np.ones(ROWS),
        "noise": rng.normal(size=ROWS),
        "gaps": np.where(np.arange(ROWS) % 3, np.nan, np.sin(9.0 * t)),
        "steps": np.sign(np.sin(30.0 * t)),
    }
    columns = {key: size * shapes[shape] for key, (size, shape) in given_columns.items()}
    return Recording(t, columns)


@fuzz(60)
@given(changed=changes)
def test_simulate_with_any_robot(folder: Path, changed: dict[str, Any]) -> None:
    path, out = folder / "robot.yaml", folder / "out.csv"
    path.write_text(yaml.safe_dump(content(**{"lock": ["wrist"], **changed})))
    command(out, "simulate", "--robot", path, "--reference", folder / "good.csv", "--out", out)


@fuzz(40)
@given(
    given_columns=columns,
    horizon=st.one_of(st.none(), st.sampled_from([0.1, 0.004, 1e-9, 0.0, -1.0, math.nan, math.inf, 1e300])),
    closed=st.booleans(),
)
def test_compare_with_any_recording(
    folder: Path, given_columns: dict[tuple[str, str], tuple[float, str]], horizon: float | None, closed: bool
) -> None:
    path, out = folder / "table.parquet", folder / "out.json"
    recording.write(drawn(given_columns), path)
    words = [*(["--horizon", horizon] if horizon is not None else ["--horizon", 0.2])]
    words += ["--closed-loop"] if closed else []
    command(out, "compare", path, "--robot", folder / "good.yaml", "--json", out, *words)


@fuzz(10)
@given(given_columns=columns)
def test_diagnose_with_any_recording(
    folder: Path, given_columns: dict[tuple[str, str], tuple[float, str]]
) -> None:
    path, out = folder / "table.csv", folder / "out.json"
    usual = {(c, j): (0.2, "wave") for c in ("q", "theta", "tau_m") for j in JOINTS}
    recording.write(drawn({**usual, **given_columns}), path)
    words = ["--quiet", "--no-refine", "--json", out]
    command(out, "diagnose", path, "--robot", folder / "good.yaml", *words)


@fuzz(40)
@given(
    poses=st.lists(st.tuples(numbers, numbers), max_size=4),
    heads=st.lists(
        st.sampled_from(["q.shoulder", "q.elbow", "q.nope", "time", "x", "q_ref.elbow"]),
        min_size=2,
        max_size=2,
    ),
    deflection=st.one_of(st.none(), st.floats()),
)
def test_theta_d_with_any_poses(
    folder: Path, poses: list[tuple[Any, Any]], heads: list[str], deflection: float | None
) -> None:
    path, out = folder / "poses.csv", folder / "out.csv"
    path.write_text("\n".join([",".join(heads), *(f"{a},{b}" for a, b in poses)]) + "\n")
    limit = [] if deflection is None else [f"--max-deflection={deflection}"]
    command(out, "theta-d", path, "--robot", folder / "good.yaml", "--out", out, *limit)


@fuzz(60)
@given(
    words=st.lists(
        st.one_of(
            st.text(max_size=12),
            st.sampled_from(["simulate", "compare", "--robot", "-", "--", "--out", "@x", "view", "--html"]),
        ),
        max_size=5,
    )
)
def test_any_words(folder: Path, words: list[str]) -> None:
    out = folder / "nothing.csv"
    known = ["simulate", "compare", "theta-d", "plan", "diagnose"]
    command_of = [known[len(words) % len(known)], *(word for word in words if word not in ("-h", "--help"))]
    if not any("--help".startswith(word) and len(word) > 1 for word in words):
        assert command(out, *command_of) == 2


def test_what_was_changed_was_good(folder: Path) -> None:
    robot = folder / "good.yaml"
    out = folder / "out.csv"
    assert command(out, "simulate", "--robot", robot, "--reference", folder / "good.csv", "--out", out) == 0
    out = folder / "out.json"
    assert (
        command(out, "compare", folder / "good.csv", "--robot", robot, "--horizon", 0.2, "--json", out) == 0
    )
    words = ["--quiet", "--no-refine", "--json", out]
    assert command(out, "diagnose", folder / "good.csv", "--robot", robot, *words) == 0
