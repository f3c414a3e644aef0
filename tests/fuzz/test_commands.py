"""The main commands with robots, recordings and options that are drawn: exit code 0 or 2, one line, no traceback,
no half-written file, no endless work."""

# ruff: noqa: E501
from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml
from fuzz.hostile import command, fuzz
from hypothesis import given
from hypothesis import strategies as st
from support.robots.robot_files import JOINT, URDF, content
from support.thorough import thorough

from flexjoint.effects import catalogue
from flexjoint.recording import table as recording
from flexjoint.recording.table import UNITS, Recording
from flexjoint.robot import robot
from flexjoint.simulation.simulate import simulate

JOINTS = ("shoulder", "elbow")
ROWS = 120
MOVED = 800  # rows of the good motion, 3.2 s: less is too little to diagnose

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
    reference = drawn({("q_ref", j): (0.2, "wave") for j in JOINTS}, MOVED)
    noise = {"q": 1e-5, "theta": 1e-5, "tau_m": 1e-3}
    moved = simulate(robot.load(made / "good.yaml"), reference, sample_rate=250.0, noise=noise).measured
    kept = {
        key: values for key, values in moved.columns.items() if key[0] in ("q", "theta", "tau_m", "tau_t")
    }
    recording.write(Recording(moved.time, kept), made / "moved.parquet")
    return made


def drawn(given_columns: dict[tuple[str, str], tuple[float, str]], rows: int = ROWS) -> Recording:
    """A recording of those sizes and shapes."""
    rng = np.random.default_rng(0)
    t = np.arange(rows) / 250.0
    shapes = {
        "wave": np.sin(9.0 * t),
        "still": np.ones(rows),
        "noise": rng.normal(size=rows),
        "gaps": np.where(np.arange(rows) % 3, np.nan, np.sin(9.0 * t)),
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


VALUES = ("empty", "constant", "scaled", "huge", "noise", "turned", "late")
STAMPS = ("early", "swapped", "backwards", "pause", "one time", "burst")
ROWWISE = ("rows", "row twice", "column")
Damage = tuple[str, int, int, int, float]
damages = st.lists(
    st.tuples(
        st.sampled_from([*VALUES, *STAMPS, *ROWWISE]),
        st.integers(0, 99),  # a column ...
        st.integers(0, MOVED - 1),  # ... from a row ...
        st.sampled_from([1, 2, 10, 60, MOVED]),  # ... for so many rows
        st.sampled_from([0.0, 1e-9, 1e-3, 0.5, -1.0, 57.3, 1e3, 1e6, 1e9, 1e20]),
    ),
    min_size=1,
    max_size=4,
)


def damaged(table: Recording, changes: list[Damage]) -> Recording:
    """A recording with each of some damages done to it, one after the other."""
    time, columns = table.time.copy(), {key: values.copy() for key, values in table.columns.items()}
    for how, column, begin, count, size in changes:
        rows = slice(begin, begin + count)
        key = list(columns)[column % len(columns)]
        if how in STAMPS:
            time[rows] = stamped(time[rows], how)
            time[begin:] += {"pause": size, "backwards": -abs(size)}.get(how, 0.0)
        elif how in VALUES:
            columns[key][rows] = changed(columns[key][rows], how, size)
        elif how == "column" and len(columns) > 1:
            del columns[key]
        elif how != "column":
            kept = np.arange(len(time))
            kept = kept[: max(2, begin)] if how == "rows" else np.sort([*kept, begin % len(time)])
            time, columns = time[kept], {key: values[kept] for key, values in columns.items()}
    return Recording(time, columns)


def stamped(time: np.ndarray, how: str) -> np.ndarray:
    """Stamps of some rows, damaged."""
    ways = {
        "early": time - 0.003,
        "swapped": time[::-1],
        "burst": np.round(time, 2),
        "one time": np.full(time.shape, time[0] if time.size else 0.0),
    }
    return ways.get(how, time).copy()


def changed(values: np.ndarray, how: str, size: float) -> np.ndarray:
    """Samples of some rows, damaged."""
    ways = {
        "empty": np.full(values.shape, np.nan),
        "constant": np.full(values.shape, values[0] if values.size else 0.0),
        "scaled": values * size,
        "huge": np.full(values.shape, size),
        "noise": values + size * np.random.default_rng(0).normal(size=values.shape),
        "turned": -values,
        "late": np.roll(values, 3),
    }
    return ways[how]


@thorough
@fuzz(6)
@given(changes=damages)
def test_diagnose_with_a_damaged_recording(folder: Path, changes: list[Damage]) -> None:
    path, out = folder / "table.parquet", folder / "out.json"
    table = damaged(recording.read(folder / "moved.parquet"), changes)
    raw = {"time": table.time, **{f"{c}.{j}": values for (c, j), values in table.columns.items()}}
    pyarrow.parquet.write_table(pa.table(raw), path)
    command(
        out, "diagnose", path, "--robot", folder / "good.yaml", "--quiet", "--budget", "5s", "--json", out
    )


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
    robot_file = folder / "good.yaml"
    out = folder / "out.csv"
    assert (
        command(out, "simulate", "--robot", robot_file, "--reference", folder / "good.csv", "--out", out) == 0
    )
    out = folder / "out.json"
    assert (
        command(out, "compare", folder / "good.csv", "--robot", robot_file, "--horizon", 0.2, "--json", out)
        == 0
    )
    words = ["--quiet", "--no-refine", "--json", out]
    assert command(out, "diagnose", folder / "good.csv", "--robot", robot_file, *words) == 0
    assert command(out, "diagnose", folder / "moved.parquet", "--robot", robot_file, *words) == 0
