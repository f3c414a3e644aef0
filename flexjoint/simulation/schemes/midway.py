"""A state and its predicted midpoint, as the default scheme sees them."""

from __future__ import annotations

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.joint import neighbours


class Midway:
    """A state and its predicted midpoint as scalars, and the signals of a joint there."""

    def __init__(self, model: FlexibleJointModel, x: State, q_mid: Value, v_mid: Value, tau_m: Value) -> None:
        items = ops.items
        self.model, self.joints, self.t = model, model.joints, x.t
        self.q, self.v, self.q_mid, self.v_mid = items(x.q), items(x.v), items(q_mid), items(v_mid)
        self.theta, self.dtheta, self.ddtheta = items(x.theta), items(x.dtheta), items(x.ddtheta)
        self.z, self.tau_m, self.tau_rigid = items(x.z), items(tau_m), items(x.tau_rigid)

    def signals(self, i: int, k: int, a: float) -> Signals:
        """Of the actuated joint i, the k-th flexible one (-1: rigid); phi from the present velocities."""
        joint, beside = self.joints[i], neighbours(self.tau_m, i)
        q, dq, t = self.q_mid[joint.idx_q], self.v_mid[joint.idx_v], self.t + a
        if k < 0:
            tau_t = self.tau_rigid[self.model.rigid.index(i)]
            return Signals(t, q, dq, q, dq, 0.0, 0.0, tau_t, self.tau_m[i], *beside)
        theta, dtheta = self.theta[k] + a * self.dtheta[k], self.dtheta[k] + a * self.ddtheta[k]
        return Signals(t, q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, self.tau_m[i], *beside)
