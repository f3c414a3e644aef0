"""How fast and how accurate a step is: `make bench`, or `python -m bench`.

Everything runs in this process on one core: chunks of about two milliseconds, the contenders in turn, again
and again; each keeps its best chunk, so that other work on the machine does not decide. 2 kHz physics, 1 kHz
control (motor PD). The error is the largest difference of a link position over 0.5 s from a tight solution
under control held at 1 kHz.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

from bench.rival import INTEGRATORS, Rival
from flexjoint import check, load_robot, read_recording, shipped_robots
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.compiled import compiled_for
from flexjoint.simulation.compiled.engine import job_of
from flexjoint.simulation.controllers import MotorPD, law_of
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs.batch import closed_loops
from flexjoint.simulation.runs.live import LiveSimulation
from flexjoint.simulation.schemes import DEFAULT, SCHEMES

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from support.robots.arms import PENDULUM, PLANAR, make, waves
from support.robots.example_robots import centauro, ur5

RATE, CONTROL = 2000.0, 1000.0
SECONDS = 0.5  # of the motion whose error is measured
FINE = 64_000.0  # steps per second of the tight solution
CHUNK, ROUNDS = 2e-3, 250  # seconds a chunk lasts about; rounds of all contenders
BATCH, BATCH_ROUNDS = 64, 15  # rollouts of a batch; rounds of all that run one
ITERATING_ROUNDS = 20
CHECK_ROUNDS = 4
BATCHED = "implicitfast"  # MuJoCo's best stable integrator on CENTAURO
SMALL = 6  # joints up to which explicit schemes of order 1 are stable at this rate
RATES = {"physics": RATE, "control": CONTROL}
ROBOTS: dict[str, Callable[[], Robot]] = {
    "one link": partial(make, PENDULUM, rates=RATES),
    "two links": partial(make, PLANAR, rates=RATES),
    "UR5": partial(ur5, **RATES),
    "CENTAURO": partial(centauro, **RATES),
}


@dataclass
class Contender:
    """Something that takes steps: `run` takes `steps` of them; error [rad], NaN where there is none."""

    name: str
    run: Callable[[], object]
    steps: int
    error: float = float("nan")
    best: float = float("inf")  # seconds per step


def references(n: int, seconds: float) -> dict[str, np.ndarray]:
    """Slow waves of 0.3 rad for every joint, each with its own phase; no feed-forward torque."""
    t = np.arange(round(seconds * CONTROL))[:, None] / CONTROL
    theta = 0.3 * (np.sin(2 * np.pi * t + 0.4 * np.arange(n)) - np.sin(0.4 * np.arange(n)))
    zero = np.zeros_like(theta)
    return {"q_ref": theta, "theta_ref": theta, "dtheta_ref": zero, "tau_ff": zero}


def by_us(robot: Robot, scheme: str, rate: float, seconds: float, kind: Engine) -> np.ndarray:
    """(ticks + 1, n) link positions at control ticks."""
    model, law = FlexibleJointModel(robot), law_of(robot)
    table = references(len(robot.joints), seconds)
    tape = closed_loop(model, model.rest(), law, table, RunOptions(rate=rate, scheme=scheme, engine=kind))
    return tape.q[tape.first :: round(rate / CONTROL)]


def tight(robot: Robot) -> np.ndarray:
    """The motion as exactly as need be: RK4 at 64 kHz."""
    return by_us(robot, "rk4", FINE, SECONDS, "compiled")


def by_mujoco(robot: Robot, integrator: str) -> np.ndarray:
    """As `by_us`, by MuJoCo under the same law, held between ticks."""
    law, table = law_of(robot), references(len(robot.joints), SECONDS)
    rival = Rival(robot, integrator, RATE)
    n = len(robot.joints)
    rival.start(np.zeros(n), np.zeros(n))
    ticks = len(table["q_ref"])
    out = np.empty((ticks + 1, n))
    out[0] = 0.0
    for k in range(ticks):
        reading = {"theta": rival.data.qpos[rival.rotor], "dtheta": rival.data.qvel[rival.rotor]}
        rival.data.ctrl[:] = law.torque({name: rows[k] for name, rows in table.items()}, reading)
        rival.run(round(RATE / CONTROL))
        out[k + 1] = rival.data.qpos[rival.link]
        if not np.isfinite(out[k + 1]).all() or rival.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            return np.full_like(out, np.nan)
    return out


def ours(robot: Robot, exact: np.ndarray) -> list[Contender]:
    model, law = FlexibleJointModel(robot), law_of(robot)
    table = references(len(robot.joints), SECONDS)
    found = []
    schemes = [DEFAULT, "rk4"]
    if len(robot.joints) <= SMALL:
        schemes += [name for name in SCHEMES if name not in schemes and not SCHEMES[name].adaptive]
    for scheme in schemes:
        q = by_us(robot, scheme, RATE, SECONDS, "compiled")
        compiled = compiled_for(model, RunOptions(rate=RATE, scheme=scheme), law=law, references=tuple(table))
        job = job_of(compiled, model, model.rest(), law, compiled.references(table))
        error = float(np.max(np.abs(q - exact)))
        found.append(Contender(f"ours, {scheme}", partial(compiled.run, job, stride=-1), job.steps, error))
        if scheme == DEFAULT:
            found.append(Contender("   the whole tape kept", partial(compiled.run, job), job.steps))
            summary = partial(compiled.run, job, stride=-1, summary=True)
            found.append(Contender("   summaries only", summary, job.steps))
    short = {name: rows[:10] for name, rows in table.items()}
    loop = partial(closed_loop, model, model.rest(), law, short, RunOptions(rate=RATE, engine="pin"))
    found.append(Contender("our pin loop (Python)", loop, 20))
    return found


def rivals(robot: Robot, exact: np.ndarray) -> list[Contender]:
    found = []
    n, law = len(robot.joints), law_of(robot)
    for integrator in INTEGRATORS:
        try:
            error = float(np.max(np.abs(by_mujoco(robot, integrator) - exact)))
        except ValueError:
            continue  # an older MuJoCo
        rival = Rival(robot, integrator, RATE)
        assert isinstance(law, MotorPD)
        rival.use_own_controller(np.broadcast_to(law.kp, n), np.broadcast_to(law.kd, n))
        rival.start(np.zeros(n), np.zeros(n))
        found.append(Contender(f"MuJoCo, {integrator}", partial(rival.run, 100), 100, error))
    return found


def raw_aba(robot: Robot) -> Contender:
    model = robot.model
    data = model.createData()
    q, v, tau = (np.full(model.nv, x) for x in (0.1, 0.2, 0.0))

    def run() -> None:
        for _ in range(100):
            pin.aba(model, data, q, v, tau)

    return Contender("pin.aba", run, 100)


def measure(contenders: list[Contender]) -> None:
    """Their best chunks, in turn."""
    repeats = []
    for contender in contenders:
        contender.run()
        begin = time.perf_counter()
        contender.run()
        repeats.append(max(1, round(CHUNK / (time.perf_counter() - begin))))
    for _ in range(ROUNDS):
        for contender, repeat in zip(contenders, repeats, strict=True):
            begin = time.perf_counter()
            for _ in range(repeat):
                contender.run()
            taken = (time.perf_counter() - begin) / (repeat * contender.steps)
            contender.best = min(contender.best, taken)


def report(name: str, robot: Robot, console: Console) -> None:
    exact = tight(robot)
    aba, own, others = raw_aba(robot), ours(robot, exact), rivals(robot, exact)
    measure([aba, *own, *others])
    step = own[0].best
    table = Table(
        "", "us per step", "of pin.aba", "of ours", "error [rad]", title=f"{name}, {len(robot.joints)}"
    )
    for one in [aba, *own, *others]:
        error = "" if np.isnan(one.error) and one not in others else f"{one.error:.1e}"
        numbers = (f"{1e6 * one.best:.3f}", f"{one.best / aba.best:.2f}", f"{one.best / step:.1f}")
        table.add_row(one.name, *numbers, "diverges" if error == "nan" else error)
    console.print(table)
    stable = [one for one in others if one.error < 0.1]
    rival = min(stable, key=lambda one: one.best)
    loop = next(one for one in own if one.name.startswith("our pin loop"))
    console.print(
        f"{name}: {step / aba.best:.2f} of one pin.aba call; {rival.best / step:.1f} times as fast as"
        f" {rival.name}, its best stable variant; {loop.best / step:.0f} times as fast as the pin loop\n"
    )


def iterating(name: str, console: Console) -> None:
    """Processor time of a step of the schemes that iterate, under given torques (where Python is in it, as
    the difference of a long and a short run), and of live simulations under the robot's motor PD. In turn,
    each with its best round."""
    model = FlexibleJointModel(ROBOTS[name]())
    torque = waves(len(model.joints), 1000, RATE)
    newton = compiled_for(model, RunOptions(rate=RATE, scheme="implicit_midpoint"))
    job = job_of(newton, model, model.rest(), None, torque)
    runs: dict[str, Callable[[], object]] = {
        "implicit_midpoint, compiled": partial(newton.run, job, stride=-1)
    }
    steps, pairs = {"implicit_midpoint, compiled": len(torque)}, []
    short, long = 10, 40
    engines: tuple[Engine, ...] = ("compiled", "pin")
    for engine in engines:
        for scheme in ("implicit_midpoint", "reference"):
            label = f"{scheme}, {engine}"
            if label in runs:
                continue
            pairs.append(label)
            options = RunOptions(rate=RATE, scheme=scheme, engine=engine)
            for count in (short, long):
                runs[f"{label}, {count}"] = partial(rollout, model, model.rest(), torque[:count], options)
        live = LiveSimulation(model, RunOptions(rate=RATE, engine=engine))
        many = 1000 if engine == "compiled" else 20
        runs[f"live, step({many}), {engine}"] = partial(live.step, many)
        runs[f"live, step(), {engine}"] = partial(_one_by_one, live, 20)
        steps |= {f"live, step({many}), {engine}": many, f"live, step(), {engine}": 20}
    best = dict.fromkeys(runs, float("inf"))
    for _ in range(ITERATING_ROUNDS + 1):
        for label, run in runs.items():
            begin = time.process_time()
            run()
            best[label] = min(best[label], time.process_time() - begin)
    table = Table("", "us per step", title=f"{name}, processor time")
    for label in pairs:
        taken = (best[f"{label}, {long}"] - best[f"{label}, {short}"]) / (long - short)
        table.add_row(label, f"{1e6 * taken:.3g}")
    for label, count in steps.items():
        table.add_row(label, f"{1e6 * best[label] / count:.3g}")
    console.print(table)


def _one_by_one(live: LiveSimulation, steps: int) -> None:
    for _ in range(steps):
        live.step()


def batches(name: str, console: Console) -> None:
    """Throughput of a batch that keeps summaries, on one core and on all: side by side in the lanes of
    registers, one rollout after the other, and by MuJoCo's own `rollout`, which keeps all states. In turn,
    each with its best round; processor time on one core, time on all."""
    robot = ROBOTS[name]()
    model, law, n = FlexibleJointModel(robot), law_of(robot), len(robot.joints)
    table, options = references(n, SECONDS), RunOptions(rate=RATE, engine="compiled")
    drive = robot.joints[0].drive
    stiffness = {f"drive.{robot.joint_names[0]}.stiffness": drive.K * np.linspace(0.5, 2.0, BATCH)}
    one = compiled_for(model, options, law=law, references=tuple(table))
    job = job_of(one, model, model.rest(), law, one.references(table))
    rival = Rival(robot, BATCHED, RATE)
    assert isinstance(law, MotorPD)
    rival.use_own_controller(np.broadcast_to(law.kp, n), np.broadcast_to(law.kd, n))
    rival.start(np.zeros(n), np.zeros(n))
    ctrl = np.repeat(table["theta_ref"], round(RATE / CONTROL), axis=0)

    def alone() -> None:
        for _ in range(BATCH):
            one.run(job, stride=-1, summary=True)

    cores = len(os.sched_getaffinity(0))
    runs: dict[str, Callable[[], object]] = {"ours, one after the other, 1 worker": alone}
    for workers in (1, cores):
        ours = partial(closed_loops, model, model.rest(), law, table, options, parameters=stiffness)
        runs[f"ours, side by side, {workers} worker(s)"] = partial(ours, workers=workers)
        runs[f"MuJoCo's rollout, {BATCHED}, {workers} thread(s)"] = rival.batch(BATCH, ctrl, workers)
    best = dict.fromkeys(runs, float("inf"))
    for _ in range(BATCH_ROUNDS + 1):
        for label, run in runs.items():
            clock = time.process_time if " 1 " in label else time.perf_counter
            begin = clock()
            run()
            best[label] = min(best[label], clock() - begin)
    table_of = Table(
        "", "times real time", "us per robot and step", title=f"{name}, {BATCH} rollouts of {SECONDS} s"
    )
    for label, taken in best.items():
        each = 1e6 * taken / (BATCH * job.steps)
        table_of.add_row(label, f"{BATCH * SECONDS / taken:.0f}", f"{each:.3f}")
    console.print(table_of)


def checks(console: Console) -> None:
    """Processor time of a check of each recording of the KR300 against its stored diagnosis, over the length
    of the recording, the start of Python left out: the best of a few."""
    place = shipped_robots()["kr300"].parent
    robot = load_robot("kr300")
    table = Table("", "of its length", title="flexjoint check, KR300")
    for path in sorted((place / "recordings").glob("*.parquet")):
        recording, best = read_recording(path), float("inf")
        for _ in range(CHECK_ROUNDS):
            begin = time.process_time()
            check(robot, recording, place / "diagnosed" / "rec_A.json")
            best = min(best, time.process_time() - begin)
        table.add_row(path.stem, f"{best / recording.duration:.3f}")
    console.print(table)


def main() -> None:
    console = Console(width=100)
    mujoco.set_mju_user_warning(lambda _: None)  # divergence is shown in the table, not in a log file
    console.print(f"flexjoint against pin {pin.__version__} and MuJoCo {mujoco.__version__}")
    for name, robot in ROBOTS.items():
        if len(sys.argv) == 1 or name in sys.argv[1:]:
            report(name, robot(), console)
    if len(sys.argv) == 1 or "batches" in sys.argv[1:]:
        for name in ("UR5", "CENTAURO"):
            batches(name, console)
    if len(sys.argv) == 1 or "iterating" in sys.argv[1:]:
        for name in ("two links", "UR5", "CENTAURO"):
            iterating(name, console)
    if len(sys.argv) == 1 or "checks" in sys.argv[1:]:
        checks(console)


if __name__ == "__main__":
    main()
