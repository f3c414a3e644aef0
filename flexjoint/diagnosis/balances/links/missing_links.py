"""Links that only their motors tell of: what an error of the balances moves them by, along a motion.

The angle of such a link follows from the nominal model (motion.py), and a number that is off, or an effect,
moves it, as its balance asks. The movement is simulated here by the equations of the links, linear about the
nominal motion:

    M(t) dq'' + (C(t) + D) dq' + (G(t) + K) dq = error of the links' balances

Then nothing is left of these balances, and the springs pull at the motors. The equations are those of the
nominal robot. With other numbers the same movement leaves a part of the balances, which whitening, by these
numbers and the mean posture, eliminates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from flexjoint.diagnosis.balances.links.movement import Movement, Numbers, add, pull, torque
from flexjoint.diagnosis.balances.links.swinging import Swinging
from flexjoint.diagnosis.balances.motion import Links, Motion
from flexjoint.diagnosis.signals.signals import reach_of_ends

FREE = 100.0  # times its RMS, a deflection that nothing prevents
GROWN = 1e3  # times a start, in rad or rad/s, from which a movement does not settle


class MissingLinks:
    """The links of a motion that have neither encoder nor torque sensor."""

    def __init__(
        self,
        motion: Motion,
        loaded: Mapping[int, int],
        motors: Mapping[int, int],
        links: Links | None = None,
    ) -> None:
        """`loaded` is the row, by joint, of the balance that carries the link's load, `motors` that of the
        motor's. `links` are the numbers by which they move, nominal ones without."""
        self._motion, self._loaded, self._motors = motion, loaded, motors
        joints = motion.robot.joints
        self._drives = [joint.drive for joint in joints] if links is None else list(links.drives)
        self._inertial = None if links is None else links.inertial
        told = np.isfinite(motion.readings.tau_t[:, 0])
        self._driven = [i for channel, i in motion.missing if channel == "q" and not told[i]]

    def __bool__(self) -> bool:
        """Whether there are any that can be followed."""
        return bool(self._driven) and self._steady

    def __len__(self) -> int:
        return len(self._driven)

    @cached_property
    def _steady(self) -> bool:
        """Whether the links settle: of a spring that is too soft for its load the linear equations may grow
        without end."""
        still = np.zeros((len(self._driven), self._motion.filter.count))
        with np.errstate(over="ignore", invalid="ignore"):
            return all(
                float(np.max(np.abs(movement.q))) < GROWN * float(np.max(np.abs(start)))
                for start in self._starts
                for _, movement in self._by_load(still, start)
            )

    @cached_property
    def _starts(self) -> list[np.ndarray]:
        """(2 k,) each link in turn elsewhere, by a multiple of its deflection's RMS, or faster, by that in
        the time of an oscillation."""
        k = len(self._driven)
        mass, stiffness = (np.mean(x, axis=0) for x in (self._swinging.followed, self._swinging.stiffness))
        deflection = FREE * np.std(self._motion.theta - self._motion.q, axis=1)[self._driven]
        rates = np.sqrt(np.abs(np.diag(stiffness)) / np.diag(mass))
        return [np.eye(2 * k)[j] * size for j, size in enumerate((*deflection, *(deflection * rates)))]

    def moved(self, errors: Mapping[int, np.ndarray], numbers: Numbers) -> dict[int, np.ndarray]:
        """(N,) by row, what errors (N,) of balances, by row, add to balances of a robot with these numbers,
        by the links that they move; nothing where no such link moves."""
        if not self:
            return {}
        still = np.zeros(self._motion.filter.count)
        force = np.array([errors.get(self._loaded[i], still) for i in self._driven])
        if not np.any(force):
            return {}
        # near its ends the filter distorts a balance, and a link would swing on from that
        begin = reach_of_ends(self._motion.readings)
        inner = np.pad(force[:, begin:-begin], ((0, 0), (begin, begin)), mode="edge")
        return self._added(self._by_load(inner), numbers)

    def free(self) -> list[dict[int, np.ndarray]]:
        """What the links add to the rows of balances, where each in turn starts elsewhere, or faster."""
        if not self:
            return []
        still = np.zeros((len(self._driven), self._motion.filter.count))
        numbers = Numbers(tuple(self._drives))
        return [self._added(self._by_load(still, start), numbers) for start in self._starts]

    def beside(self, links: Links) -> MissingLinks:
        """The same links, moved by other numbers."""
        return MissingLinks(self._motion, self._loaded, self._motors, links)

    def swing(self, series: Mapping[int, np.ndarray]) -> tuple[np.ndarray, float]:
        """(2 k,) by how much the links start elsewhere [rad], and faster [rad/s], so that they leave least of
        the motors' balances `series` (N,), by joint, and the share of these that is then taken away: a link
        that swings at the start swings on at a frequency of its own. A start that is off by more than the
        deflection's RMS is unlikely."""
        own = [i for i in self._driven if i in series]
        used, filtered = self._motion.readings.valid, self._motion.filter.smooth
        left = np.array([series[i][used] for i in own])
        size = np.sqrt(np.mean(left**2, axis=1, keepdims=True)) + 1e-300
        still = np.zeros((len(self._driven), self._motion.filter.count))
        starts = [start / FREE for start in self._starts]
        columns = []
        for start in starts:
            moved = dict(self._by_load(still, start))
            pulled = [pull(self._drives[i], moved[i]) for i in own]
            columns.append((filtered(np.array(pulled))[:, used] / size).ravel())
        by_start, y = np.array(columns), (left / size).ravel()
        slope = by_start @ y
        share = np.linalg.solve(by_start @ by_start.T + np.eye(len(starts)), -slope)
        return np.asarray(share @ np.array(starts)), float(-share @ slope / (y @ y))

    def _added(self, movements: Sequence[tuple[int, Movement]], numbers: Numbers) -> dict[int, np.ndarray]:
        """(N,) by row, what movements of these links add to the balances."""
        out: dict[int, np.ndarray] = {}
        for i, movement in movements:
            pulled = pull(numbers.drives[i], movement)
            add(out, self._loaded[i], -pulled)
            if i in self._motors:
                add(out, self._motors[i], numbers.scale(i) * pulled)
            for joint, row in self._loaded.items():
                add(out, row, -torque(self._motion, joint, i, movement, numbers))
        return out

    def _by_load(self, force: np.ndarray, start: np.ndarray | None = None) -> list[tuple[int, Movement]]:
        """What torques (k, N) on the driven links move them by, with a `start` (`Swinging.by`)."""
        return list(zip(self._driven, self._swinging.by(force, start), strict=True))

    @cached_property
    def _swinging(self) -> Swinging:
        return Swinging(*self._driven_matrices, self._motion.filter.period)

    @cached_property
    def _driven_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N, k, k) mass, damping and stiffness of the driven links with their springs."""
        rigid, pick = self._motion.rigid, np.ix_(range(self._motion.filter.count), self._driven, self._driven)
        nominal = self._inertial is None
        along = (rigid.by_q, rigid.by_v, rigid.mass) if nominal else rigid.derivatives(self._inertial)
        by_q, by_v, mass = (x[pick] for x in along)
        drives = [self._drives[i] for i in self._driven]
        damping, stiffness = (np.diag([getattr(drive, name) for drive in drives]) for name in ("D", "K"))
        return np.asarray(mass), by_v + damping, by_q + stiffness
