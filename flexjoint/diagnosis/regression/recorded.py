"""What the balances of a recording say of sets of effects, before any number is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from flexjoint.diagnosis.balances.balances import TwinBalances
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.whitening import Whitening
from flexjoint.effects import Effect, Planned, Signals
from flexjoint.model.joint import neighbours


class Recorded:
    """A recording with its balances, and the nominal model's effects."""

    def __init__(self, balances: TwinBalances) -> None:
        self.balances = balances
        self.motion, self.robot = balances.motion, balances.motion.robot
        self.readings = self.motion.readings
        self.settings = self.readings.settings
        self.torque_scale = balances.torque_scale()
        self.nominal = tuple(self.robot.effects)
        self._signals: dict[str | None, Signals] = {}
        self._starts: dict[tuple[str, str | None], tuple[dict[str, float], ...]] = {}

    @cached_property
    def whitening(self) -> Whitening:
        """Of the balances, under the nominal model."""
        scale = np.array([self.torque_scale[row.joint] for row in self.balances.rows])
        return whitening.make(self.balances, scale, ())

    @property
    def deviation(self) -> np.ndarray:
        """(rows,) standard deviation that the sensors' noise has in each balance [N m]."""
        return self.whitening.deviation

    def with_nominal(self, extra: Sequence[Planned]) -> list[Planned]:
        """The nominal model's effects with these added; one that it lists already is replaced."""
        keys = {e.key for e in extra}
        return [e for e in self.nominal if e.key not in keys] + list(extra)

    def starts(self, effect: Effect, joint: str | None) -> tuple[dict[str, float], ...]:
        """From where an effect of a joint is looked for."""
        key = effect.name, joint
        if key not in self._starts:
            self._starts[key] = effect.starts(self.signals(joint))
        return self._starts[key]

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
        torque = np.where(np.isfinite(self.readings.torque), self.readings.torque, 0.0)[:, used]
        before, after = (x * np.ones(t.size) for x in neighbours(torque, i))
        return Signals(
            t=t,
            q=q[used],
            dq=smooth(q, 1)[used],
            theta=theta[used],
            dtheta=smooth(theta, 1)[used],
            phi=(theta - q)[used],
            dphi=smooth(theta - q, 1)[used],
            tau_t=self.motion.rigid.tau[i][used],
            tau_m=torque[i],
            tau_m_before=before,
            tau_m_after=after,
        )
