"""One recording against one robot, ready to be asked: how well does this set of effects explain it?

Every nominal number is a random variable with the robot's tolerance as its standard deviation. Its
sensitivity column J (in units of that deviation) is marginalised out of every comparison: energies are
    Q(y, y) = min over d of |y - J d|^2 + |d|^2,
so that what the tolerances can explain is explained first, and only what they cannot counts.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from scipy import fft
from scipy.linalg import cho_factor, cho_solve

from flexjoint.diagnose import whitening
from flexjoint.diagnose.balances import TwinBalances
from flexjoint.diagnose.motion import reconstruct
from flexjoint.diagnose.nuisance import NUMBERS, Columns, as_effects
from flexjoint.diagnose.signals import denoised, prepare
from flexjoint.effect import Planned, Signals
from flexjoint.recording import Recording
from flexjoint.robot import Robot

PLAUSIBLE = 2.5  # prior deviations up to which a nominal number may be off before a cause must be sought
NOISY = 3.0  # temper above which sensor noise no longer decides anything
TEMPER_ROUNDS = 12
TELLING = 100.0  # energy that must remain, for a cause to be able to earn its price
FEWEST = 100  # independent samples that a recording is credited with at least
FAR_OFF = 2.5  # prior deviations beyond which a nominal number is taken out of its linear neighbourhood


class Workspace:
    """Whitened residuals and their inner products with the nominal model's tolerances marginalised."""

    def __init__(self, balances: TwinBalances) -> None:
        self.balances = balances
        self.motion, self.robot = balances.motion, balances.motion.robot
        self.readings = self.motion.readings
        self.torque_scale = self._torque_scale()
        rows = self.balances.rows
        scale = np.array([self.torque_scale[r.joint] for r in rows])
        self.whitening = whitening.make(balances, scale, ())
        self.time = self.whitening.time
        self.samples = self.time.size * len(rows)
        self.freedom = self.time.size * self.whitening.freedom
        self.nominal = tuple(self.robot.effects)
        self._signals: dict[str | None, Signals] = {}
        self._columns = Columns(balances.quiet, self.whitening)
        self.nuisance, self._plain = self._columns.nuisance, self._columns.matrix
        self._moved, self._move = np.zeros(0, dtype=int), np.zeros((0, self.samples))
        self.temper = np.ones(len(rows))
        self.strain = 1.0  # the factor in `temper` that stands for implausible nominal numbers
        self.used = np.ones(self.time.size)
        self._plain_grams = self._grams = self._grams_of_rows()
        self._weigh()

    @property
    def J(self) -> np.ndarray:
        """(numbers, samples) whitened columns of the nominal numbers, one prior deviation each."""
        if not len(self._moved):
            return self._plain
        out = self._plain.copy()  # which is not kept: it is by far the largest array there is
        out[self._moved] += self._move
        return out

    def _grams_of_rows(self) -> np.ndarray:
        """(rows, k, k) products of the nominal numbers' plain columns over each balance's used samples."""
        k, rows = len(self._plain), len(self.balances.rows)
        split = self._plain.reshape(k, rows, self.time.size)
        out = np.empty((rows, k, k))
        for row in range(rows):
            part = split[:, row] * self.used
            out[row] = part @ part.T
        return out

    def _moved_grams(self) -> np.ndarray:
        """(rows, k, k) the same of the columns where some are moved from the plain ones."""
        rows, at = len(self.balances.rows), self._moved
        plain = self._plain.reshape(len(self._plain), rows, self.time.size)
        moved = (self._plain[at] + self._move).reshape(len(at), rows, self.time.size)
        out = self._plain_grams.copy()
        for row in range(rows):
            part = moved[:, row] * self.used
            across = part @ plain[:, row].T
            across[:, at] = part @ moved[:, row].T
            out[row, at] = across
            out[row][:, at] = across.T
        return out

    def _weigh(self) -> None:
        # J is never stored weighted, for its size
        self.weights = np.outer(1.0 / np.sqrt(self.temper), self.used).ravel()
        self.squares = np.outer(1.0 / self.temper, self.used).ravel()
        self.gram = np.tensordot(1.0 / self.temper, self._grams, 1) + np.eye(len(self._plain))
        self._gram = cho_factor(self.gram)

    def at(self, temper: np.ndarray, strain: float = 1.0) -> Workspace:
        """The same workspace with each balance's variance taken as `temper` (rows,) times the predicted
        noise: for comparing models of which none is complete."""
        other = copy.copy(self)
        other.temper, other.strain = temper, strain
        other._weigh()
        return other

    def about(self, effects: Sequence[Planned]) -> Workspace:
        """The same workspace with the nominal numbers' columns taken where these effects, beyond the nominal
        model's, are at work: what dry friction holds at rest follows the springs."""
        changed = self._columns.beside_friction(self.with_nominal(effects))
        if not changed and not len(self._moved):
            return self
        other = copy.copy(self)
        other._moved = np.array(list(changed), dtype=int)
        other._move = (
            np.array(list(changed.values())).reshape(len(changed), self.samples) - self._plain[other._moved]
        )
        other._grams = other._moved_grams() if changed else self._plain_grams
        other._weigh()
        return other

    def only(self, used: np.ndarray) -> Workspace:
        """The same workspace with only some samples (bool, as many as `time`) counted."""
        other = copy.copy(self)
        other.used = used.astype(float)
        other._plain_grams = other._grams = other._grams_of_rows()
        if len(self._moved):
            other._grams = other._moved_grams()
        other._weigh()
        return other

    def tempered(self, y: np.ndarray) -> Workspace:
        """The workspace at the variances that a residual y shows once the nominal numbers have explained
        what they plausibly can; correlated leftovers count as the few independent samples they are."""
        here = self.at(np.ones_like(self.temper))
        for _ in range(TEMPER_ROUNDS):
            levels = here.levels(y)
            if np.all(levels <= 1.02 * here.temper):
                break
            here = here.at(np.maximum(levels, here.temper))
        while np.max(np.abs(here.deviations(y)), initial=0.0) > PLAUSIBLE and here.energy(y) > 2.0 * TELLING:
            here = here.at(2.0 * here.temper, 2.0 * here.strain)
        if here.energy(y) <= 2.0 * TELLING:
            return here
        return here.at(np.maximum(here.temper, here.levels(y)), here.strain)

    def levels(self, y: np.ndarray) -> np.ndarray:
        """(rows,) variance of what the nominal numbers leave of y, times its correlation time in samples;
        at least 1."""
        rest = self.rest(y).reshape(len(self.balances.rows), -1)
        count = rest.shape[1]
        longest = count // 4
        size = fft.next_fast_len(count + longest, real=True)  # no lag that is used wraps around
        spectrum = np.abs(fft.rfft(rest, size, axis=1)) ** 2
        correlation = fft.irfft(spectrum, size, axis=1)[:, :longest]
        correlation = correlation / np.maximum(correlation[:, :1], 1e-300)
        past = np.cumsum(correlation < 0.05, axis=1) > 0
        length = 1.0 + 2.0 * np.sum(np.where(past, 0.0, correlation)[:, 1:], axis=1)
        # a constant error is one long correlation, and still no accident
        return np.maximum(1.0, np.mean(rest**2, axis=1) * np.minimum(length, count / FEWEST))

    # ------------------------------------------------------------------ residuals
    def whitened(self, effects: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual with exactly these effects (nominal ones included) at work."""
        return self.whitening.apply(self.balances.residual(effects)).ravel()

    def residual(self, extra: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual with these effects beyond (or instead of) the nominal model's.

        Effects that change what noise makes of a balance (an inertia, a stiffness, a gain) enter through
        their trace on the denoised recording: a fit must not be drawn towards numbers that shrink a
        balance, and its noise with it (errors in variables; Fuller 1987)."""
        every, loud = self.with_nominal(extra), self._loud(extra)
        y = self.whitened(loud)
        return y if len(loud) == len(every) else y + self._quiet_change(loud, every)

    def moved(self, extra: Sequence[Planned], other: Sequence[Planned]) -> np.ndarray:
        """(samples,) residual(other) - residual(extra), at the cost of the joints that differ."""
        a, b = self._loud(extra), self._loud(other)
        change = self.whitening.apply(self.balances.change(a, b)).ravel()
        every_a, every_b = self.with_nominal(extra), self.with_nominal(other)
        if len(a) < len(every_a) or len(b) < len(every_b):
            change = change + self._quiet_change(every_a, every_b) - self._quiet_change(a, b)
        return change

    def quietly_moved(self, extra: Sequence[Planned], other: Sequence[Planned]) -> np.ndarray:
        """(samples,) the same along the denoised recording."""
        return self._quiet_change(self.with_nominal(extra), self.with_nominal(other))

    def _loud(self, extra: Sequence[Planned]) -> list[Planned]:
        """The effects that are evaluated on the recording as it is, noise included."""
        kept = [e for e in extra if not whitening.changes_noise(e)]
        replaced = {e.key for e in extra}
        return [e for e in self.nominal if e.key not in replaced or whitening.changes_noise(e)] + kept

    def _quiet_change(self, base: Sequence[Planned], effects: Sequence[Planned]) -> np.ndarray:
        return self.whitening.apply(self.balances.quiet.change(base, effects)).ravel()

    def with_nominal(self, extra: Sequence[Planned]) -> list[Planned]:
        """The nominal model's effects with these added; one that it lists already is replaced."""
        keys = {e.key for e in extra}
        return [e for e in self.nominal if e.key not in keys] + list(extra)

    # ------------------------------------------------------------------ inner products
    def pull(self, y: np.ndarray) -> np.ndarray:
        """(numbers,) how a residual y pulls at the nominal numbers: J W y."""
        return self._across((y * self.squares)[None])[0]

    def _across(self, a: np.ndarray) -> np.ndarray:
        """(k, numbers) a J' of columns a (k, samples)."""
        out = a @ self._plain.T
        out[:, self._moved] += a @ self._move.T
        return out

    def _along(self, d: np.ndarray) -> np.ndarray:
        """(..., samples) d J of deviations d (..., numbers)."""
        return d @ self._plain + d[..., self._moved] @ self._move

    def energy(self, y: np.ndarray) -> float:
        """Q(y, y)."""
        pull = self.pull(y)
        y = y * self.weights
        return float(y @ y - pull @ cho_solve(self._gram, pull))

    def judged_energy(self, y: np.ndarray, effects: Sequence[Planned]) -> float:
        """Q(y, y), evaluated in full (noise and all) and whitened for the noise of the model that it implies,
        where that is another than the nominal one's."""
        pull = self.deviations(y)
        far = np.max(self.temper) < NOISY and np.max(np.abs(pull), initial=0.0) > FAR_OFF
        if not far and not any(whitening.changes_noise(e) for e in effects):
            return self.energy(y)
        shifted = as_effects(self.nuisance, -pull, self.motion.rigid.inertial, self.robot)
        held = [*self.with_nominal(effects), *shifted]
        scale = np.array([self.torque_scale[r.joint] for r in self.balances.rows])
        there = whitening.make(self.balances, scale, held)
        residual = there.apply(self.balances.residual(held)).ravel()
        # other nominal numbers (of effects, offsets) change no noise: their part stays linear
        residual = (residual - self._linear_part(pull)) * self.weights
        return float(residual @ residual) + float(pull @ pull)

    def _linear_part(self, pull: np.ndarray) -> np.ndarray:
        moved = (*NUMBERS, "inertial", "link_encoder_offset", "motor_encoder_offset")
        other = [k for k, n in enumerate(self.nuisance) if n.name not in moved]
        return pull[other] @ self.J[other] if other else np.zeros(self.samples)

    def product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Q between columns a (k, samples) and b (l, samples): (k, l)."""
        weighted = a * self.squares
        by_a = self._across(weighted)
        by_b = by_a if b is a else self._across(b * self.squares)
        return weighted @ b.T - by_a @ cho_solve(self._gram, by_b.T)

    def against(self, a: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(k,) Q between columns a (k, samples) and a residual y (samples,)."""
        return self.product(a, y[None])[:, 0]

    def deviations(self, y: np.ndarray) -> np.ndarray:
        """Deviations of the nominal numbers, in prior deviations, that explain most of a residual y."""
        return cho_solve(self._gram, self.pull(y))

    def deviation_errors(self) -> np.ndarray:
        """Standard errors of `deviations`."""
        return np.sqrt(np.diag(cho_solve(self._gram, np.eye(len(self._plain)))))

    def rest(self, y: np.ndarray) -> np.ndarray:
        """(samples,) what the nominal numbers leave of a residual."""
        return y - self._along(self.deviations(y))

    def project(self, a: np.ndarray) -> np.ndarray:
        """Columns a (k, samples) with what the nominal numbers can explain of them taken out."""
        return a - self._along(cho_solve(self._gram, self._across(a * self.squares).T).T)

    @property
    def noise_energy(self) -> float:
        """Energy that the predicted noise alone has at this temper."""
        return float(np.sum(1.0 / self.temper)) * self.freedom / len(self.temper)

    def signals(self, joint: str | None) -> Signals:
        """Measured signals of a joint on usable samples, as `Effect.starts` sees them."""
        if joint not in self._signals:
            self._signals[joint] = self._signals_of(joint)
        return self._signals[joint]

    def _signals_of(self, joint: str | None) -> Signals:
        used, smooth = self.readings.valid, self.balances.filter.smooth
        t = self.balances.chains.t[used]
        if joint is None:
            return Signals(t=t)
        i = self.robot.joint_names.index(joint)
        q, theta = self.motion.q[i], self.motion.theta[i]
        torque = self.readings.torque[i]
        return Signals(
            t=t,
            q=q[used],
            dq=smooth(q, 1)[used],
            theta=theta[used],
            dtheta=smooth(theta, 1)[used],
            phi=(theta - q)[used],
            dphi=smooth(theta - q, 1)[used],
            tau_t=self.motion.rigid.tau[i][used],
            tau_m=np.where(np.isfinite(torque), torque, 0.0)[used],
        )

    # ------------------------------------------------------------------ nominal numbers
    def _torque_scale(self) -> np.ndarray:
        """(n,) RMS torque of each joint [N m]: the larger of motor and load, about zero."""
        used = self.readings.valid
        load = np.sqrt(np.mean(self.motion.rigid.tau[:, used] ** 2, axis=1))
        torque = self.readings.torque[:, used]
        drive = np.sqrt(np.mean(np.where(np.isfinite(torque), torque, 0.0) ** 2, axis=1))
        return np.maximum(np.maximum(load, drive), 1e-6)

    def inertial_column(self, i: int, change: np.ndarray) -> np.ndarray:
        """(samples,) whitened trace of a change (10,) of the inertial parameters of joint i's link."""
        return self._columns.load_column(self.balances.quiet.inertial_torque(i, change))


def balances_of(robot: Robot, recording: Recording) -> TwinBalances:
    """The balances of a recording against a robot, with a denoised twin; RecordingError when the
    sensors do not allow any."""
    readings = prepare(robot, recording)
    return TwinBalances(
        reconstruct(robot, readings, recording), reconstruct(robot, denoised(readings), recording)
    )
