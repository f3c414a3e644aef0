"""The gallery of effects: what each looks like in the residual and in the simulation, from the catalogue.

One joint (a lever under gravity; two for a coupling of joints) follows the same motion with and without the
effect, of the size that the study plants. Sizes are the generator's, figures those of
docs/studies/diagnosis_study.md; the smallest sizes that were found are in smallest_sizes.json, written by
`python -m study smallest`.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
import pinocchio as pin
from flexjoint_benchmark.planting import ROBOTS
from flexjoint_benchmark.planting.catalogue import law
from flexjoint_benchmark.planting.sizes import usual_effect
from matplotlib.figure import Figure

import flexjoint as fj
from flexjoint.cli.robots.effects import SITES, summary, typical_sizes
from flexjoint.diagnosis.result.wording import effect_name, number, unit_of
from flexjoint.effects import Effect, Site
from flexjoint.report.plots import AFTER, BEFORE, STYLE
from flexjoint_benchmark.score import EQUIVALENT

DOCS = Path(__file__).parents[1]
SECONDS, RATE = 8.0, 1000.0
ONE, TWO = ("lever", "swing"), ("crane", "")  # robot and joint; of the second, the last joint
WAVES = ((0.5, 0.45, 0.0), (1.3, 0.18, 1.0), (2.9, 0.05, 2.0))  # frequency [Hz], amplitude [rad], phase
BALANCES = {
    "motor": "motor: tau_m - B ddtheta - D_m dtheta - tau_t",
    "spring": "spring: tau_t - K phi - D dphi",
    "link": "link: tau_t - inverse dynamics",
    "rigid": "motor: tau_m - B ddtheta - D_m dtheta - inverse dynamics",  # of a joint without a spring
}
TOLD_APART = (  # docs/explained/diagnosis.md, "Ties": what looks alike in a poor recording, and what parts it
    ("torque_gain", "motor_coulomb_friction", "a rich motion with tau_t"),
    ("motor_coulomb_friction", "link_coulomb_friction", "tau_t or both encoders"),
    ("motor_viscous_friction", "link_viscous_friction", "tau_t or both encoders"),
    ("torque_gain", "torque_sensor_gain", "a second recording with a known payload"),
    ("sensor_delay", "link_viscous_friction", "q and tau_t"),
)
REACHED = ("torque_saturation", "torque_speed_limit", "end_stop")  # limits: as large as the motion meets ...
BEYOND = 0.45  # ... with this share of its largest value, times a size (planting.cases.met_by)
HEAD = """\
# Gallery of effects

Generated from the catalogue by `make site`. A lever on a flexible joint (two joints for a coupling) follows
the same motion with and without the effect, of the size that
[the study](docs/studies/diagnosis_study.md) plants. Left: the residual of the torque balance in which it
shows most, over the signal that it depends on (the nominal model's is zero). Right: how far the link
goes astray in the simulation. The smallest sizes are of one machine, one motion and one draw of the noise
each, on robots whose files trust their numbers to 2 %: what lies within that is no finding. Typical sizes
are those that makers of parts and published identifications state, each with a link; an effect for which no
such source was found has none. Sizes on real machines are those that the sources of
[shipped robots](docs/reference/robots.md) with recordings state, and those that the KR300's
[stored diagnosis](docs/studies/real_machines.md) found; the sizes here are the study's, a judgement.
Definitions, ranges and defaults: [effects](docs/reference/effects.md).
"""


def page(folder: Path) -> str:
    """The page; pictures go to `folder`, and those that are there and fresh are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    for site in Site:
        # a learned law has no shape of its own to be shown
        effects = [e for _, e in sorted(fj.catalogue().items()) if e.site is site and e.is_cause]
        if effects:
            parts += [f"## {SITES[site].rstrip('.')}", *(_card(effect, folder) for effect in effects)]
    return "\n\n".join(parts) + "\n"


def _card(effect: Effect, folder: Path) -> str:
    planted = _planted(effect)
    lines = [
        f"### {effect_name(effect.name)[0].upper()}{effect_name(effect.name)[1:]}",
        f"`{effect.name}`. {summary(effect)}",
    ]
    if effect.law:
        lines.append(f"$${effect.law}$$")
    lines.append(
        f"![{effect.name}: residual and simulation](gallery_pictures/{_picture(effect, planted, folder)})"
    )
    units = {p.name: p.unit for p in effect.params}
    size = ", ".join(
        f"{k} {_number(v)} {units.get(k, '').replace('1', '')}".strip() for k, v in planted.items()
    )
    lines.append(f"Here: {size}. Reference: {effect.reference or 'none'}.")
    lines.append(typical_sizes(effect))
    lines.append(" ".join([*_real(effect), *_alike(effect), *_study(effect.name), *_smallest(effect)]))
    return "\n\n".join(line for line in lines if line)


def _number(value: Any) -> str:
    return number(value) if isinstance(value, int | float) else str(value)


def _real(effect: Effect) -> list[str]:
    """Its main number on real machines: as their makers state it, and as the stored diagnosis found it."""
    if effect.name not in {*_stated(), *_found()}:
        return []
    name = law(effect.name).required[0]
    unit = next(param.unit for param in effect.params if param.name == name).replace("1", "")
    said = [
        f"{_range(sizes)} {unit} stated of the {robot}" for robot, sizes in _stated().get(effect.name, ())
    ]
    found = _found().get(effect.name)
    said += [f"{_range(found)} {unit} found on the kr300"] if found else []
    return [f"On real machines: {name} {'; '.join(said)}."]


def _range(sizes: list[float]) -> str:
    least, most = (_number(one) for one in (min(sizes), max(sizes)))
    return least if least == most else f"{least} to {most}"


@cache
def _stated() -> dict[str, list[tuple[str, list[float]]]]:
    """By effect, the real machines whose files list it, each with its sizes."""
    stated: dict[str, list[tuple[str, list[float]]]] = {}
    for name, path in fj.shipped_robots().items():
        if not (path.parent / "recordings").is_dir():
            continue
        own: dict[str, list[float]] = {}
        for e in fj.load_robot(name).effects:
            own.setdefault(e.effect.name, []).append(abs(e.values[law(e.effect.name).required[0]]))
        for effect, sizes in own.items():
            stated.setdefault(effect, []).append((name, sizes))
    return stated


@cache
def _found() -> dict[str, list[float]]:
    """By effect, its sizes in the stored diagnosis of the KR300, of causes that are more likely than not.
    What changes a number that the nominal model has is no size."""
    nominal = {(e.effect.name, e.joint) for e in fj.load_robot("kr300").effects}
    path = fj.shipped_robots()["kr300"].parent / "diagnosed" / "rec_A.json"
    found: dict[str, list[float]] = {}
    for one in json.loads(path.read_text(encoding="utf-8"))["findings"]:
        size = one["parameters"][law(one["effect"]).required[0]]["value"]
        if one["probability"] >= 0.5 and (one["effect"], one["joint"]) not in nominal and size > 0.0:
            found.setdefault(one["effect"], []).append(size)
    return found


def _alike(effect: Effect) -> list[str]:
    """What it is confused with, in any recording, and what tells it from what it contains."""
    same = sorted({name for group in EQUIVALENT if effect.name in group for name in group} - {effect.name})
    out = []
    if same:
        out.append(
            f"The same to any experiment as {_listed(same)} ([ties](docs/explained/diagnosis.md#ties))."
        )
    for pair in TOLD_APART:
        if effect.name in pair[:2]:
            (other,) = {*pair[:2]} - {effect.name}
            out.append(f"Told from `{other}` by {pair[2]}.")
    if effect.contains:
        out.append(
            f"It contains {_listed(effect.contains)}, which is left where a motion does not excite the rest."
        )
    return out or ["No other effect is the same to every recording."]


def _listed(names: Any) -> str:
    return " and ".join(f"`{name}`" for name in names)


@cache
def _tables() -> dict[str, dict[str, str]]:
    """Rows of the study's tables of confusion, by effect."""
    rows: dict[str, dict[str, str]] = {}
    heads: list[str] = []
    for line in (DOCS / "studies" / "diagnosis_study.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("| planted |"):
            heads = cells
        elif heads and line.startswith("| ") and len(cells) == len(heads):
            rows.setdefault(cells[0], dict(zip(heads, cells, strict=True)))
        elif not line.startswith("|"):
            heads = []
    return rows


def _study(name: str) -> list[str]:
    row = _tables().get(name)
    if row is None or not row.get("cases", "").isdigit():
        return []
    exact, tied = (int(row.get(k) or 0) for k in ("exact", "tied"))
    said = f"In the study it was named exactly in {exact} of {row['cases']} cases above the noise"
    said += f", beside a tie in {tied} more." if tied else "."
    wrong = row.get("false names", "")
    return [said, f"Named in its place: {wrong or 'nothing'}."]


@cache
def _sizes() -> dict[str, list[dict[str, Any]]]:
    """Rows of the smallest sizes by effect (`tests/study/smallest.py` wrote them)."""
    rows: dict[str, list[dict[str, Any]]] = {}
    table = json.loads((Path(__file__).parent / "smallest_sizes.json").read_text(encoding="utf-8"))
    for row in table["rows"]:
        rows.setdefault(row["effect"], []).append(row)
    return rows


def _smallest(effect: Effect) -> list[str]:
    """The smallest size that was found on two robots of the study."""
    said = []
    for row in _sizes().get(effect.name, []):
        found, robot = row["found"], row["robot"]
        if found is None:
            said.append(f"not at its usual size on the {robot} ({row['missed']})")
            continue
        numbers = {name: x for name, x in found["parameters"].items() if isinstance(x, int | float)}
        name = law(effect.name).required[0]
        if effect.name == "base_tilt":  # what is turned about a joint's own axis shows nothing
            name = max(numbers, key=lambda key: abs(numbers[key]))
        units = {param.name: param.unit for param in effect.params}
        value = f"{_number(abs(numbers[name]))} {units.get(name, '').replace('1', '')}".strip()
        share = f"1/{round(1 / found['size'])} of the usual size" if found["size"] < 1.0 else "the usual size"
        if effect.name in REACHED:
            share = f"which the motion meets with the last {_number(100 * BEYOND * found['size'])} %"
        least = "" if row["missed"] else ", the least that was tried"
        said.append(f"{name} {value} on the {robot} ({share}{least})")
    if not said:
        return []
    return [f"Smallest that was found, of sizes halved, with full sensors in 10 s: {'; '.join(said)}."]


# --- pictures ---------------------------------------------------------------------------------------------
def _picture(effect: Effect, planted: dict[str, Any], folder: Path) -> str:
    source = Path(inspect.getfile(type(effect))).read_bytes() + Path(__file__).read_bytes()
    name = f"{effect.name}-{hashlib.sha256(source + repr(planted).encode()).hexdigest()[:10]}.svg"
    if not (folder / name).exists():
        for old in folder.glob(f"{effect.name}-*.svg"):
            old.unlink()
        _draw(effect, planted, folder / name)
    return name


def _draw(effect: Effect, planted: dict[str, Any], path: Path) -> None:
    robot, joint = _robot(effect)
    nominal = _nominal(robot.name, effect.for_rigid)
    where = None if effect.whole_robot else joint
    run = fj.simulate(
        fj.FlexibleJointModel(robot, [fj.effect(effect.name, where, **planted)]), _reference(robot)
    )
    residuals = _residuals(robot, run.measured, joint)
    balance = max(residuals, key=lambda b: float(np.sqrt(np.mean(residuals[b] ** 2))))
    x = _signal(run.measured, effect.against, joint, robot.joint_names)
    astray = 1e3 * (run.true.get("q", joint) - nominal.true.get("q", joint))
    inner = slice(200, -20)  # derivatives at the ends
    with matplotlib.style.context(["default", {**STYLE, "font.size": 8, "axes.labelsize": 8}]):
        figure = Figure(figsize=(7.6, 2.1))
        left, right = figure.subplots(1, 2)
        left.plot(
            x[inner][::3], residuals[balance][inner][::3], ".", color=BEFORE, markersize=1.6, rasterized=True
        )
        left.set_xlabel(f"{effect.against} [{unit_of(effect.against, False) or 's'}]")
        left.set_ylabel(f"{BALANCES[balance].split(':')[0]} residual [N m]")
        left.set_title(BALANCES[balance], fontsize=7, loc="left", color="#52606d")
        right.plot(run.true.time, astray, color=AFTER, linewidth=0.9)
        right.set_xlabel("time [s]")
        right.set_ylabel("q - nominal q [mrad]")
        figure.tight_layout()
        figure.savefig(path, format="svg", dpi=110, metadata={"Date": None, "Creator": None})


def _signal(run: fj.Recording, name: str, joint: str, joints: tuple[str, ...]) -> np.ndarray:
    """(N,) a signal that effects may depend on."""
    if name == "t":
        return run.time
    if name in ("phi", "dphi"):
        motor, link = ("theta", "q") if name == "phi" else ("dtheta", "dq")
        return run.get(motor, joint) - run.get(link, joint)
    if name in ("tau_m_before", "tau_m_after"):
        other = joints.index(joint) + (-1 if name == "tau_m_before" else 1)
        return run.get("tau_m", joints[other])
    return run.get(name, joint)


def _robot(effect: Effect) -> tuple[fj.Robot, str]:
    name, joint = TWO if effect.name == "joint_coupling" or effect.reaches_before else ONE
    robot = _loaded(name, effect.for_rigid)
    return robot, joint or robot.joint_names[-1]


@cache
def _loaded(name: str, rigid: bool = False) -> fj.Robot:
    robot = fj.load_robot(ROBOTS / f"{name}.yaml")
    joints = (replace(joint, drive=replace(joint.drive, K=np.inf, D=0.0)) for joint in robot.joints)
    return replace(robot, joints=tuple(joints)) if rigid else robot


def _reference(robot: fj.Robot) -> fj.Recording:
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    rise = np.clip(time, 0.0, 1.0) ** 2 * (3 - 2 * np.clip(time, 0.0, 1.0))  # from rest
    columns = {}
    for k, joint in enumerate(robot.joint_names):
        waves = sum(a * np.sin(2 * np.pi * f * (1 + 0.2 * k) * time + p) for f, a, p in WAVES)
        columns["q_ref", joint] = rise * waves
    return fj.make_recording(time, columns)


@cache
def _nominal(name: str, rigid: bool = False) -> fj.Simulation:
    robot = _loaded(name, rigid)
    return fj.simulate(fj.FlexibleJointModel(robot), _reference(robot))


def _residuals(robot: fj.Robot, run: fj.Recording, joint: str) -> dict[str, np.ndarray]:
    """(N,) [N m] of each balance of the nominal numbers, along the measured motion."""
    drive, time, rigid = robot.joint(joint).drive, run.time, robot.joint(joint).rigid
    get = lambda channel, name=joint: run.get(channel, name)  # noqa: E731
    tau_t, phi, dphi = get("tau_t"), get("theta") - get("q"), get("dtheta") - get("dq")
    seen = ("theta", "dtheta") if rigid else ("q", "dq")
    q, dq = (np.stack([get(c, name) for name in robot.joint_names], axis=1) for c in seen)
    ddq = np.gradient(dq, time, axis=0)
    data = robot.model.createData()
    place = robot.joint(joint).idx_v
    load = np.array([pin.rnea(robot.model, data, *state)[place] for state in zip(q, dq, ddq, strict=True)])
    driven = get("tau_m") - drive.B * np.gradient(get("dtheta"), time) - drive.D_m * get("dtheta")
    if rigid:
        return {"rigid": driven - load}
    return {
        "motor": driven - tau_t,
        "spring": tau_t - drive.K * phi - drive.D * dphi,
        "link": tau_t - load,
    }


def _planted(effect: Effect) -> dict[str, Any]:
    """The usual size; of what depends on the motion, what this one meets."""
    robot, joint = _robot(effect)
    run = _nominal(robot.name, effect.for_rigid).true
    torque, speed, angle = (np.abs(run.get(c, joint)).max() for c in ("tau_m", "dtheta", "q"))
    met = {
        "torque_saturation": {"limit": 0.7 * torque},
        "torque_speed_limit": {"stall": 0.9 * torque, "drop": 0.3 * torque / speed},
        "end_stop": {"position": 0.7 * angle, "stiffness": 4 * float(robot.joint(joint).drive.K)},
        "rough_spot": {"level": 0.08 * 120.0, "position": 0.1, "width": 0.1},
    }
    if effect.for_rigid:  # the spring that its file gives the robot
        drive = _loaded(robot.name).joint(joint).drive
        return {
            "compliance": float(f"{1.0 / drive.K:.3g}"),
            "relaxation": float(f"{drive.D / drive.K:.3g}"),
        }
    if effect.name in met:
        return {name: float(f"{value:.3g}") for name, value in met[effect.name].items()}
    try:
        planted = usual_effect(effect.name, robot.name, joint, np.random.default_rng(1))
    except ValueError:  # the generator has no law of it: the catalogue's own default
        return {param.name: param.value for param in effect.params}
    return {name: value for name, value in planted.parameters.items() if value is not None}
