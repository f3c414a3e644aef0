"""How well does a set of effects explain a recording, beside the tolerances of the nominal model?

Every nominal number is a random variable with the robot's tolerance as its standard deviation. Its
sensitivity column J (in units of that deviation) is marginalised out of every comparison: energies are
    Q(y, y) = min over d of |y - J d|^2 + |d|^2,
so that the tolerances explain as much as they can, and only what they cannot explain counts.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft
from scipy.linalg import cho_factor, cho_solve

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.balances import MOTOR, TwinBalances
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.nuisance import Columns
from flexjoint.diagnosis.regression.recorded import Recorded
from flexjoint.diagnosis.regression.whitening import Band, Whitening
from flexjoint.effects import Planned

LEVEL_ROUNDS = 12
UNCORRELATED = 0.05  # a correlation below this counts as zero: it is estimated no better
REMEMBERED = 2.5e7  # bytes of residuals and their derivatives, and of columns that effects move


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """The variance that each balance's residual is judged against, over that of the predicted noise.

    A level above 1 lets sets of effects be compared of which none is complete: what they leave counts as
    noise. `inflation` (rows,) is the factor of each balance; `implausibility` (rows,) is the part of it (a
    factor, 1 where there is none) that keeps nominal numbers from being pulled further than machines' are."""

    inflation: np.ndarray
    implausibility: np.ndarray | float = 1.0

    @property
    def implausible(self) -> float:
        """The largest factor by which it keeps nominal numbers plausible; 1 where it need not."""
        return float(np.max(self.implausibility))

    @classmethod
    def predicted(cls, rows: int) -> NoiseLevel:
        """The level of the predicted noise alone."""
        return cls(np.ones(rows))


@dataclass(frozen=True)
class Moves:
    """The columns of some nominal numbers that effects change, and the products of these with all columns."""

    numbers: np.ndarray  # (m,) indices
    columns: np.ndarray  # (m, samples) beside the effects: exactly 0 of a claim in whose place an effect is
    across: np.ndarray  # (rows, m, k) over each balance's used samples

    @property
    def nbytes(self) -> int:
        return self.columns.nbytes + self.across.nbytes

    def put(self, products: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Products (..., k, k) of the plain columns, with those (..., m, k) of the changed ones in place."""
        if self.numbers.size:
            products[..., self.numbers, :] = across
            products[..., :, self.numbers] = np.swapaxes(across, -1, -2)
        return products


class Problem(Recorded):
    """A recording's regression problem: whitened residuals and their inner products, with the nominal model's
    tolerances marginalised, at one noise level (`level`; that of the predicted noise where none is given).

    Frozen: `at`, `about` and `only` give another problem that shares what does not change. What is remembered
    (residuals, columns) is the same for any of them."""

    def __init__(self, balances: TwinBalances, level: NoiseLevel | None = None) -> None:
        super().__init__(balances)
        rows = self.balances.rows
        self.time = self.whitening.time
        self.samples = self.time.size * len(rows)
        self.freedom = self.time.size * self.whitening.freedom
        self._recent: LruCache[np.ndarray] = LruCache()
        self._moves: LruCache[Moves] = LruCache()
        self._columns = Columns(balances.denoised, self.whitening, self.readings)
        self.nuisance, self._plain = self._columns.nuisance, self._columns.matrix
        self.torque_noise_kept = _torque_noise_kept(balances, self.whitening)
        self._entangled: tuple[Planned, ...] = ()  # effects beside which actuators' numbers do something else
        self.level = NoiseLevel.predicted(len(rows)) if level is None else level
        self.used = np.ones(self.time.size)
        self.counted = np.ones(len(rows), dtype=bool)  # balances that count
        self._grams = self._grams_of_rows(self.used)
        self.gram, self._gram = self._weighed()
        self._frozen = True

    def __setattr__(self, name: str, value: object) -> None:
        if vars(self).get("_frozen"):
            raise AttributeError(f"{name}: a problem is frozen; `at`, `about` and `only` give another one")
        super().__setattr__(name, value)

    def _changed(self, **values: object) -> Problem:
        """A copy with some values of its own, and the products that depend on them."""
        other = copy.copy(self)
        vars(other).update(values)
        gram, factor = other._weighed()
        vars(other).update(gram=gram, _gram=factor)
        return other

    @property
    def J(self) -> np.ndarray:
        """(numbers, samples) whitened columns of the nominal numbers, one prior deviation each. By far the
        largest array of a diagnosis, and copied where effects change some columns: `pull`, `across` and
        `along` multiply by it without the copy."""
        if not self._entangled:
            return self._plain
        out = self._plain.copy()
        out[self.moves.numbers] = self.moves.columns
        return out

    @property
    def moves(self) -> Moves:
        """What effects change of the nominal numbers' columns. It is large and seldom needed again, so that
        it is not stored with each of many fits, but computed again where it is no longer remembered."""
        effects = self._entangled
        return self._moves.get(_entangling(effects), lambda: self._moves_by(effects), REMEMBERED)

    def _grams_of_rows(self, used: np.ndarray) -> np.ndarray:
        """(rows, k, k) products of the nominal numbers' plain columns over each balance's used samples."""
        k, rows = len(self._plain), len(self.balances.rows)
        split = self._plain.reshape(k, rows, self.time.size)
        out = np.empty((rows, k, k))
        for row in range(rows):
            part = split[:, row] * used
            out[row] = part @ part.T
        return out

    @property
    def by_row(self) -> np.ndarray:
        """(rows,) by which squares of each balance's residual are multiplied; 0 where it does not count."""
        return np.asarray(self.counted / self.level.inflation)

    def _moved_across(self, at: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """(rows, m, k) the same of other columns of some numbers with all. What effects do not change of a
        balance is not multiplied again."""
        rows = len(self.balances.rows)
        plain = self._plain.reshape(len(self._plain), rows, self.time.size)
        moved = columns.reshape(len(at), rows, self.time.size)
        out = self._grams[:, at]
        for row in range(rows):
            others = np.flatnonzero(np.any(moved[:, row] != plain[at, row], axis=1))
            if not others.size:
                continue
            here, part = at[others], moved[others, row] * self.used
            across = part @ plain[:, row].T
            across[:, here] = part @ moved[others, row].T
            out[row, others] = across
            out[row][:, here] = across[:, at].T
        return out

    def _weighed(self) -> tuple[np.ndarray, Any]:
        """(k, k) products of the nominal numbers' columns with their priors, and their Cholesky factor."""
        # J is never stored weighted, for its size
        gram = self._product_of_rows(self.by_row) + np.eye(len(self._plain))
        return gram, cho_factor(gram)

    def _product_of_rows(self, by_row: np.ndarray) -> np.ndarray:
        """(k, k) products of the nominal numbers' columns, of each balance times a factor."""
        moves = self.moves
        return moves.put(np.tensordot(by_row, self._grams, 1), np.tensordot(by_row, moves.across, 1))

    @property
    def weights(self) -> np.ndarray:
        """(samples,) by which a residual is multiplied at this noise level; 0 where it is not used."""
        return np.outer(np.sqrt(self.by_row), self.used).ravel()

    @property
    def squares(self) -> np.ndarray:
        """(samples,) squares of the weights."""
        return np.outer(self.by_row, self.used).ravel()

    def at(self, level: NoiseLevel) -> Problem:
        """The same problem at another noise level."""
        return self._changed(level=level)

    def about(self, effects: Sequence[Planned]) -> Problem:
        """The same problem with the nominal numbers' columns evaluated with these effects, beyond the
        nominal model's, at work (`nuisance.entangles`)."""
        entangled = self._columns.entangled(self.with_nominal(effects))
        here = tuple(e for own in entangled.values() for e in own)
        if _entangling(here) == _entangling(self._entangled):
            return self
        return self._changed(_entangled=here)

    def _moves_by(self, effects: Sequence[Planned]) -> Moves:
        changed = self._columns.beside(effects)
        numbers = np.array(list(changed), dtype=int)
        columns = np.array(list(changed.values())).reshape(len(changed), self.samples)
        return Moves(numbers, columns, self._moved_across(numbers, columns))

    def shared(self) -> list[object]:
        """What this problem has in common with all others of its recording."""
        return [one for one in (*vars(self).values(), *self.nominal) if not isinstance(one, (int, float))]

    def only(self, used: np.ndarray) -> Problem:
        """The same problem with only some samples (bool, as many as `time`) counted."""
        counted = used.astype(float)
        return self._changed(used=counted, _grams=self._grams_of_rows(counted), _moves=LruCache())

    def beside(self, effects: Sequence[Planned]) -> Problem:
        """The same problem of a nominal model that has these effects, too."""
        return self._changed(nominal=tuple(self.with_nominal(effects)), _recent=LruCache())

    def of_joint(self, joint: str, effects: Sequence[Planned]) -> Problem:
        """The same problem with one joint's balances counted only, beside these effects of other joints as
        they are."""
        at = self.robot.joint_names.index(joint)
        counted = np.array([row.joint == at for row in self.balances.rows])
        return self.beside(effects)._changed(counted=counted)

    def free_level(self, y: np.ndarray) -> NoiseLevel:
        """The noise level that a residual y shows, where the nominal numbers explain all that they can,
        implausible values included."""
        here = self.at(NoiseLevel.predicted(len(self.balances.rows)))
        for _ in range(LEVEL_ROUNDS):
            variances = here.variances(y)
            if np.all(variances <= 1.02 * here.level.inflation):
                break
            here = here.at(NoiseLevel(np.maximum(variances, here.level.inflation)))
        return here.level

    def plausible_level(self, y: np.ndarray) -> NoiseLevel:
        """The noise level that a residual y shows, where the nominal numbers explain only what plausible
        values can: as long as some of them are pulled further, the joint whose balance tells most of the
        furthest is raised, unless too little is left there to name any cause. Other joints keep theirs: what
        is wrong with a shoulder says nothing of a wrist. Where a joint is flexible all are raised together:
        an error of its encoder, times its stiffness, is more torque than most causes have."""
        limits = self.settings.regression
        base = self.free_level(y).inflation
        pulls = self._pulls(y)
        raised = np.ones_like(base)
        rigid = all(joint.rigid for joint in self.robot.joints)
        together = np.array([row.joint if rigid else -1 for row in self.balances.rows])
        information = (self.counted / base)[:, None] * self._squares_by_row()
        tells = information > limits.telling_share * np.max(information, axis=0)
        while True:
            by_row = self.counted / (base * raised)
            gram = self._product_of_rows(by_row) + np.eye(len(self._plain))
            deviations = cho_solve(cho_factor(gram), by_row @ pulls)
            rest = (y - self.along(deviations)).reshape(len(base), -1)
            left = np.sum((rest * self.used) ** 2, axis=1)
            joined = together[:, None] == together
            open_rows = joined @ (by_row * left) + deviations @ deviations > 2.0 * limits.telling
            current = information / raised[:, None]
            # what was raised until others tell far more of a number does not hold it any more
            holds = current > limits.telling_share * np.max(current, axis=0)
            told = current * (tells & holds & open_rows[:, None])
            far = np.where(self._columns.claimed & np.any(told, axis=0), np.abs(deviations), 0.0)
            if np.max(far, initial=0.0) <= limits.plausible:
                break
            most = np.argmax(told[:, np.argmax(far)])
            raised[open_rows & (together == together[most])] *= 2.0
        level = NoiseLevel(base * raised, raised)
        found = np.maximum(level.inflation, np.where(open_rows, self.at(level).variances(y), 0.0))
        return NoiseLevel(found, raised)

    def _squares_by_row(self) -> np.ndarray:
        """(rows, k) squares of the nominal numbers' columns over each balance's used samples."""
        moves, out = self.moves, np.diagonal(self._grams, axis1=1, axis2=2).copy()
        if moves.numbers.size:
            out[:, moves.numbers] = moves.across[:, np.arange(moves.numbers.size), moves.numbers]
        return out

    def _pulls(self, y: np.ndarray) -> np.ndarray:
        """(rows, numbers) J y of each balance's used samples, without weights."""
        by_row = y.reshape(len(self.balances.rows), -1) * self.used
        plain = self._plain.reshape(len(self._plain), *by_row.shape)
        out, moves = np.einsum("krt,rt->rk", plain, by_row, optimize=True), self.moves
        out[:, moves.numbers] = np.einsum("krt,rt->rk", moves.columns.reshape(-1, *by_row.shape), by_row)
        return out

    def variances(self, y: np.ndarray) -> np.ndarray:
        """(rows,) variance of what the nominal numbers leave of y, in that of the predicted noise, times its
        correlation time in samples (correlated samples count as the few independent ones that they are); at
        least 1."""
        rest = self.rest(y).reshape(len(self.balances.rows), -1)
        count = rest.shape[1]
        longest = count // 4
        size = fft.next_fast_len(count + longest, real=True)  # no lag that is used wraps around
        spectrum = np.abs(fft.rfft(rest, size, axis=1)) ** 2
        correlation = fft.irfft(spectrum, size, axis=1)[:, :longest]
        correlation = correlation / np.maximum(correlation[:, :1], 1e-300)
        past = np.cumsum(correlation < UNCORRELATED, axis=1) > 0
        length = 1.0 + 2.0 * np.sum(np.where(past, 0.0, correlation)[:, 1:], axis=1)
        # a constant error is correlated over the whole recording, and is still evidence of an error
        longest_one = count / self.settings.regression.fewest_samples
        found = np.maximum(1.0, np.mean(rest**2, axis=1) * np.minimum(length, longest_one))
        return np.where(self.counted, found, 1.0)

    # ------------------------------------------------------------------ residuals
    def whitened(self, effects: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual with exactly these effects (nominal ones included) at work."""
        return self.whitening.apply(self.balances.residual(effects)).ravel()

    def residual(self, extra: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual with these effects beyond (or instead of) the nominal model's.

        Effects that change how noise enters a balance (an inertia, a stiffness, a gain) are evaluated on the
        denoised recording: otherwise a fit would prefer numbers that make a balance smaller and its noise
        with it (errors in variables; Fuller 1987). The residual is the same at any noise level, so it is
        remembered; only what differs from the nominal model's is computed, joint by joint."""
        return self.remembered("residual", extra, lambda: self._residual(extra))

    def _residual(self, extra: Sequence[Planned]) -> np.ndarray:
        if not extra:
            return self.whitened(self.nominal)
        every, measured = self.with_nominal(extra), self._on_measured(extra)
        change = self.balances.changed(self.nominal, measured)
        if self._shapes_noise(extra):
            _add(change, self.balances.denoised.changed(measured, every))
        return self.residual([]) + self.whitening.white(self.whitening.band(change)).ravel()

    def remembered(self, what: str, effects: Sequence[Planned], make: Callable[[], np.ndarray]) -> np.ndarray:
        """An array that depends only on the effects beyond the nominal model's. It must not be changed."""
        return self._recent.get((what, *(e.identity for e in effects)), make, REMEMBERED)

    def moved(self, extra: Sequence[Planned], other: Sequence[Planned]) -> np.ndarray:
        """(samples,) residual(other) - residual(extra); only joints that differ are evaluated."""
        return self.whitening.white(self.moved_band(extra, other)).ravel()

    def moved_slightly(self, extra: Sequence[Planned], other: Sequence[Planned]) -> np.ndarray:
        """`moved` by other numbers of one effect, or by one more, to first order where that is known
        (`Balances.changed_slightly`)."""
        return self.whitening.white(self.slightly_moved_band(extra, other)).ravel()

    def slightly_moved_band(self, extra: Sequence[Planned], other: Sequence[Planned]) -> Band:
        """The same before it is whitened."""
        a, b = self._on_measured(extra), self._on_measured(other)
        if [e.identity for e in a] != [e.identity for e in b]:
            change = self.balances.changed_slightly(a, b)
        else:  # an effect that changes the noise
            every = self.with_nominal(extra), self.with_nominal(other)
            change = self.balances.denoised.changed_slightly(*every)
        return self.moved_band(extra, other) if change is None else self.whitening.band(change)

    def moved_band(self, extra: Sequence[Planned], other: Sequence[Planned]) -> Band:
        """The same before it is whitened."""
        a, b = self._on_measured(extra), self._on_measured(other)
        change = self.balances.changed(a, b)
        if self._shapes_noise(extra) or self._shapes_noise(other):
            every_a, every_b = self.with_nominal(extra), self.with_nominal(other)
            _add(change, self.balances.denoised.changed(every_a, every_b))
            _add(change, self.balances.denoised.changed(a, b), -1.0)
        return self.whitening.band(change)

    def denoised_moved_band(self, extra: Sequence[Planned], other: Sequence[Planned]) -> Band:
        """`moved_band` along the denoised recording."""
        before, after = self.with_nominal(extra), self.with_nominal(other)
        return self.whitening.band(self.balances.denoised.changed(before, after))

    def _shapes_noise(self, extra: Sequence[Planned]) -> bool:
        return any(whitening.shapes_noise(e, self.balances) for e in extra)

    def _on_measured(self, extra: Sequence[Planned]) -> list[Planned]:
        """The effects that are evaluated on the recording as it is, noise included."""
        kept = [e for e in extra if not whitening.shapes_noise(e, self.balances)]
        replaced = {e.key for e in extra}
        shaping = [e for e in self.nominal if whitening.shapes_noise(e, self.balances)]
        return [e for e in self.nominal if e.key not in replaced or e in shaping] + kept

    # ------------------------------------------------------------------ inner products
    def pull(self, y: np.ndarray) -> np.ndarray:
        """(numbers,) J W y: half the gradient of the energy of a residual y in the nominal numbers."""
        return self.across((y * self.squares)[None])[0]

    @property
    def bare_gram(self) -> np.ndarray:
        """(numbers, numbers) J J' of the samples that are used, at the predicted noise."""
        return self._product_of_rows(self.counted.astype(float))

    def across(self, a: np.ndarray) -> np.ndarray:
        """(k, numbers) a J' of columns a (k, samples)."""
        out, moves = a @ self._plain.T, self.moves
        out[:, moves.numbers] = a @ moves.columns.T
        return out

    def across_part(self, a: np.ndarray, row: int, part: slice) -> np.ndarray:
        """(k, numbers) the same over a part of the recording in one balance, a (k, size of the part), without
        what effects change of the columns."""
        plain = self._plain.reshape(len(self._plain), len(self.balances.rows), self.time.size)
        return np.asarray(a @ plain[:, row, part].T)

    def along(self, d: np.ndarray) -> np.ndarray:
        """(..., samples) d J of deviations d (..., numbers)."""
        moves = self.moves
        plain = np.array(d)
        plain[..., moves.numbers] = 0.0
        return np.asarray(plain @ self._plain + d[..., moves.numbers] @ moves.columns)

    def energy(self, y: np.ndarray) -> float:
        """Q(y, y)."""
        pull = self.pull(y)
        y = y * self.weights
        return float(y @ y - pull @ cho_solve(self._gram, pull))

    def product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Q between columns a (k, samples) and b (l, samples): (k, l)."""
        weighted = a * self.squares
        by_a = self.across(weighted)
        by_b = by_a if b is a else self.across(b * self.squares)
        return weighted @ b.T - by_a @ cho_solve(self._gram, by_b.T)

    def normal(self, a: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q among columns a (k, samples), (k, k), and with a residual y (samples,), (k,): `product` and
        `against` in one pass, as a product with the nominal numbers' columns takes long."""
        both = np.concatenate([a, y[None]])
        products = self.product(both, both)
        return products[:-1, :-1], products[:-1, -1]

    def against(self, a: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(k,) Q between columns a (k, samples) and a residual y (samples,)."""
        return self.product(a, y[None])[:, 0]

    def deviations(self, y: np.ndarray) -> np.ndarray:
        """Deviations of the nominal numbers, in prior deviations, that explain most of a residual y."""
        return cho_solve(self._gram, self.pull(y))

    def furthest(self, y: np.ndarray) -> float:
        """The largest of the deviations of numbers that the robot file claims, in prior deviations."""
        return float(np.max(np.abs(self.deviations(y)[self._columns.claimed]), initial=0.0))

    def deviation_errors(self) -> np.ndarray:
        """Standard errors of `deviations`."""
        return np.sqrt(np.diag(cho_solve(self._gram, np.eye(len(self._plain)))))

    def rest(self, y: np.ndarray) -> np.ndarray:
        """(samples,) what the nominal numbers leave of a residual."""
        return y - self.along(self.deviations(y))

    def rest_by_row(self, y: np.ndarray) -> np.ndarray:
        """(rows, n) the same by balance, in deviations of the noise at this level: its squares are energy."""
        return (self.rest(y) * self.weights).reshape(len(self.balances.rows), -1)

    def project(self, a: np.ndarray) -> np.ndarray:
        """Columns a (k, samples) with what the nominal numbers can explain of them taken out."""
        return a - self.along(cho_solve(self._gram, self.across(a * self.squares).T).T)

    @property
    def noise_energy(self) -> float:
        """Energy that the predicted noise alone has at this noise level."""
        return float(np.sum(self.by_row)) * self.freedom / len(self.counted)

    # ------------------------------------------------------------------ nominal numbers
    def jumped(self, deviations: np.ndarray) -> np.ndarray:
        """(rows, N) filtered balances [N m] of the torques between samples that deviations (numbers,)
        imply."""
        torque = self.balances.filter.smooth(self._columns.jump_torque(deviations))
        motor = np.array([row.balance == MOTOR for row in self.balances.rows], dtype=bool)
        return np.asarray(torque[[row.joint for row in self.balances.rows]] * motor[:, None])

    def inertial_band(self, i: int, change: np.ndarray) -> Band:
        """Trace, before it is whitened, of a change (10,) of the inertial parameters of joint i's link."""
        return self._columns.load_band(self.balances.denoised.inertial_torque(i, change))


def _torque_noise_kept(balances: TwinBalances, of: Whitening) -> np.ndarray:
    """(rows,) the share of a balance's noise that is its motor torque's, and that the denoised recording
    still has: a Wiener filter keeps the noise of frequencies in which there is a signal."""
    noisy, clean = balances.motion.readings.torque, balances.denoised.motion.readings.torque
    kept = np.array(of.of_torque)
    for r, row in enumerate(balances.rows):
        if row.balance != MOTOR or kept[r] == 0.0:
            continue
        taken = balances.filter.spectrum(noisy[row.joint] - clean[row.joint]) * balances.filter.gain
        white = of.white(of.band({r: taken})).reshape(len(kept), -1)[r]
        kept[r] = max(0.0, kept[r] - float(np.mean(white**2)))
    return kept


def _entangling(effects: Sequence[Planned]) -> tuple[object, ...]:
    """What the nominal numbers' columns depend on of effects: the place of a claim may be taken by an effect
    with the same numbers."""
    return tuple((e.identity, e.nominal) for e in effects)


def _add(spectra: dict[int, np.ndarray], more: dict[int, np.ndarray], sign: float = 1.0) -> None:
    """Add spectra by row, in place."""
    for row, spectrum in more.items():
        spectra[row] = spectra.get(row, 0.0) + sign * spectrum
