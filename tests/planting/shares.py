"""How much of a joint's torque each planted effect is, on a motion: what makes an effect large or small.

The torque of an effect is what motor and link lack, on the motion as it was, when the effect alone is struck
from the equations; of a sensor's effect, what the nominal balances then lack by its readings. Dry friction
counts where it slips. Its share is the RMS of that torque over the RMS of the motor's, the larger of motor
and link; a rigid joint has one balance.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from .catalogue import CATALOGUE, Planted, law
from .machine.chain import Array, body_load, mass_matrix
from .machine.drive import Drive
from .machine.laws import Equations
from .machine.sensing import CURRENT, Motion
from .robots import Robot
from .simulate import Run, nominal_dynamics

SAMPLES = 1500  # at which the equations are evaluated: 8 s of motion at some 200 Hz
GRAVITY_STEP = 1e-4  # rad, for the slope of the load
IN_DRIVE = (*(name for name, own in CATALOGUE.items() if own.site == "command"), "current_lag")


class Torques:
    """Torques of planted effects on a motion; `effects` are those that `run` had, all on from the start.

    `others` are effects that were not there; they may have no state of their own.
    """

    def __init__(
        self,
        nominal: Robot,
        real: Robot,
        run: Run,
        effects: Sequence[Planted],
        others: Sequence[Planted] = (),
    ) -> None:
        self.nominal, self.run = nominal, run
        self.had, self.effects = len(effects), [*effects, *others]
        first = run.told.first
        self.ticks = first + np.arange(len(run.states) - first)
        self.rows = self.ticks[:: max(len(self.ticks) // SAMPLES, 1)]
        self.scale = np.sqrt(np.mean(run.torques[self.ticks] ** 2, axis=0))  # (n,) RMS torque [N m]
        self._given = self._accelerations()
        self._lack = self._balance(real)
        self._nominal_lack = self._balance(nominal)

    def share(self, k: int) -> Array:
        """(n,) the share of effect number k in every joint's torque."""
        return self._over(self._lacking(k))

    def together(self, numbers: Sequence[int]) -> Array:
        """(n,) the share of the sum of some effects' torques."""
        total = sum((self._lacking(k) for k in numbers), np.zeros((2 * len(self.scale), len(self.rows))))
        return self._over(total)

    def of_numbers(self) -> Array:
        """(n,) the share of what nominal numbers that are off make, effects as they are."""
        on = self._gates()
        return self._over(self._lack(on) - self._nominal_lack(on))

    # ------------------------------------------------------------------ parts
    def _over(self, lacking: Array) -> Array:
        n = len(self.scale)
        rms = np.sqrt(np.mean(lacking**2, axis=1))
        return np.maximum(rms[:n], rms[n:]) / self.scale

    def _gates(self, changed: int | None = None) -> Array:
        gates = np.array([float(k < self.had) for k in range(len(self.effects))])
        if changed is not None:
            gates[changed] = 1 - gates[changed]
        return gates

    def _lacking(self, k: int) -> Array:
        """(2 n, rows) of motors, then links; the sign is that of the effect or its opposite."""
        planted = self.effects[k]
        n = len(self.scale)
        if law(planted.effect).site == "sensor":
            return self._by_readings(planted)
        if planted.effect in (*IN_DRIVE, "joint_coupling", "drive_resonance") and planted.effect != "cogging":
            return np.vstack([self._by_drive(k).T, np.zeros((n, len(self.rows)))])
        return self._lack(self._gates()) - self._lack(self._gates(k))

    def _accelerations(self) -> Array:
        """(2 n, rows) q'' and theta'' at the end of the ticks."""
        n, machine, run = len(self.scale), self.run.machine, self.run
        e = machine.equations
        rate = ca.Function("rate", [e.x, e.u, e.modes, e.gates, e.t], [e.rate])
        gates = np.ones((len(e.effects), len(self.rows)))
        at = (run.states[self.rows].T, run.torques[self.rows].T, run.modes[self.rows].T, gates, self._times())
        rates = np.array(rate(*at))
        return np.vstack([rates[n : 2 * n], rates[3 * n : 4 * n]])

    def _times(self) -> Array:
        """(1, rows) [s]"""
        return (self.run.told.times[self.rows] + 1 / self.nominal.control_rate)[None]

    def _balance(self, robot: Robot):
        """What motors and links (2 n, rows) lack on the motion, as a function of the gates."""
        e, run, n = Equations(robot, self.effects), self.run, len(self.scale)
        lack = ca.Function("lack", [e.x, e.u, e.modes, e.gates, e.t, e.accelerations], [e.balance])
        states = np.zeros((e.x.numel(), len(self.rows)))
        held = run.states[self.rows].T
        states[: len(held)] = held
        had = {switch: k for k, switch in enumerate(run.machine.switches)}
        modes = np.zeros((len(e.switches), len(self.rows)))
        for k, switch in enumerate(e.switches):
            if switch in had:
                modes[k] = run.modes[self.rows, had[switch]]
            elif switch.kind == "gap":
                modes[k] = np.sign(held[2 * n + switch.joint] - held[switch.joint])
            else:
                modes[k] = np.sign(held[{"link": n, "motor": 3 * n}[switch.kind] + switch.joint])
        torques, times = run.torques[self.rows].T, self._times()

        def at(gates: Array) -> Array:
            on = np.repeat(gates[:, None], len(self.rows), axis=1)
            return np.array(lack(states, torques, modes, on, times, self._given))

        return at

    def _by_drive(self, k: int) -> Array:
        """(rows, n) difference that an effect of the drive makes to the torque."""
        one = [self.effects[k]]
        first = max(self.run.told.first - 1, 0)
        commands, times = self.run.tau_m, self.run.told.times
        drive = Drive(self.nominal, one, commands[first], len(commands), 1)
        given = np.array([drive.apply(i, times[i], commands[i])[-1] for i in range(len(commands))])
        return (given - commands)[self.rows]

    def _by_readings(self, planted: Planted) -> Array:
        """(2 n, rows): the nominal balances' change by the readings' errors, linear in them."""
        run, r = self.run, self.nominal
        n, step = len(self.scale), 1 / r.control_rate
        times = run.told.times[self.ticks]
        alone = type(run.sensors)(r, [planted], run.sensors.set, 1, np.random.default_rng(0))
        rows = self.rows - self.ticks[0]
        out = np.zeros((2 * n, len(rows)))
        if planted.word("channel") in ("tau_t", CURRENT) or planted.effect.startswith("torque_sensor"):
            read = run.torques[self.ticks]
            out[:n] = (alone.changed(_torque_channel(planted), read.copy(), times) - read)[rows].T
            return out
        j = slice(None) if planted.joint is None else r.index(planted.joint)
        error = {
            c: alone.clean(c, run.motion, times) - self._true(c, run.motion, times) for c in ("q", "theta")
        }
        rate = {c: np.gradient(e, step, axis=0) for c, e in error.items()}
        second = {c: np.gradient(e, step, axis=0) for c, e in rate.items()}
        rigid = np.isinf(r.stiffness)
        inertia, slope = _load_slopes(r, run.states[self.ticks[0], :n])
        own = r.motor_inertia * second["theta"] + r.motor_damping * rate["theta"]
        side = np.where(rigid, error["theta"], error["q"])
        second_side = np.where(rigid, second["theta"], second["q"])
        load = second_side @ inertia + side @ slope
        spring = np.where(rigid, 0.0, r.stiffness)
        spring = np.where(rigid, 0.0, spring * (error["theta"] - error["q"]))
        motor = own + np.where(rigid, load, spring)
        link = np.where(rigid, 0.0, spring - load)
        kept = np.zeros(n)
        kept[j] = 1.0  # of neighbours it is told by their own
        out[:n], out[n:] = (kept * motor)[rows].T, (kept * link)[rows].T
        return out

    @staticmethod
    def _true(channel: str, motion: Motion, times: Array) -> Array:
        return motion.at(channel, np.repeat(times[:, None], motion.values[channel].shape[1], axis=1))


def _torque_channel(planted: Planted) -> str:
    return planted.word("channel") or "tau_t" if "channel" in law(planted.effect).words else "tau_t"


def _load_slopes(robot: Robot, q: Array) -> tuple[Array, Array]:
    """(n, n) inertia of the links, and the slope of the torque that holds them, at q (n,)."""
    n = len(robot.joints)
    at = ca.SX.sym("q", n)
    bodies = list(robot.bodies)
    matrix = ca.Function("m", [at], [mass_matrix(bodies, [body_load(b) for b in bodies], at)])
    hold, rest = nominal_dynamics(robot), np.zeros((n, n))
    ends = [hold(q + sign * GRAVITY_STEP * np.eye(n), rest, rest) for sign in (1, -1)]
    return np.array(matrix(q)), (ends[0] - ends[1]) / (2 * GRAVITY_STEP)
