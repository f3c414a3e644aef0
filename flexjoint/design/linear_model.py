"""A linear model with named signals: continuous or sampled with held control, as python-control has it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg

from flexjoint.core.errors import MissingExtraError, ModelError, unknown

if TYPE_CHECKING:
    import control

WHOLE = 1e-9  # of a tick by which a delay may miss a whole number of ticks and still count as one


@dataclass(frozen=True, kw_only=True)
class LinearModel:
    """dx = A x + B u, y = C x + D u about a point; x[n + 1] = A x[n] + B u[n] where `dt` is a time.

    Deviations from the point: x (nx,) of `states`, u (nu,) of `inputs` [N m], y (ny,) of `outputs`.
    Positions are tangent: joint angles, and for a floating base the motion in its own frame.

    drift (nx,): dx/dt at the point itself, 0 at an equilibrium. input_delay (nu,), output_delay (ny,) [s]:
    dead times that A, B, C, D do not hold; a sampled model holds them as states.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_delay: np.ndarray
    output_delay: np.ndarray
    drift: np.ndarray = field(repr=False)
    dt: float | None = None
    name: str = "robot"

    @property
    def poles(self) -> np.ndarray:
        """(nx,) eigenvalues of A [1/s, or per sample]."""
        return np.linalg.eigvals(self.A)

    @property
    def delayed(self) -> bool:
        return bool(np.any(self.input_delay > 0.0) or np.any(self.output_delay > 0.0))

    def places(self, kind: str, names: Iterable[str]) -> list[int]:
        """Places of named `states`, `inputs` or `outputs`; UnknownNameError lists the valid ones."""
        valid = getattr(self, kind)
        out = []
        for name in names:
            if name not in valid:
                raise unknown(kind.removesuffix("s"), name, valid)
            out.append(valid.index(name))
        return out

    def sampled(self, rate: float, delay: float = 0.0) -> LinearModel:
        """The model at the ticks of a controller at `rate` [Hz]: its command acts `delay` [s] after the tick
        (time to compute) and holds for a tick; dead times become states. Exact, for a linear model.

        Source: Astrom and Wittenmark 1997, chapter 2 (zero-order hold, delays).
        Raises ModelError for a model that is sampled already, a rate <= 0 or a delay < 0.
        """
        if self.dt is not None:
            raise ModelError(
                f"the model is sampled already, at {1.0 / self.dt:g} Hz; sample the continuous one"
            )
        if not rate > 0.0 or not delay >= 0.0:
            raise ModelError(f"expected a rate > 0 Hz and a delay >= 0 s, got {rate} Hz and {delay} s")
        return _sampled(self, 1.0 / rate, self.input_delay + delay)

    def to_control(self, pade: int | None = None) -> control.StateSpace:
        """The model as a python-control system; signals named as here, with _ in place of the dot.

        Args:
            pade: order of the Pade approximation of dead times; 0 leaves them out. It must be chosen where a
                continuous model has dead times.

        Raises:
            MissingExtraError: python-control is not installed.
            ModelError: dead times, and no order chosen.
        """
        ct = python_control()
        if self.dt is None and self.delayed and pade is None:
            raise ModelError(
                "the model has dead times: choose the order of their Pade approximation (pade=2; pade=0"
                " leaves them"
                " out), or sample it (`sampled`), which is exact"
            )
        inputs, outputs = [_plain(n) for n in self.inputs], [_plain(n) for n in self.outputs]
        system = ct.ss(self.A, self.B, self.C, self.D, **({} if self.dt is None else {"dt": self.dt}))
        states = [_plain(name) for name in self.states]
        if self.dt is None and self.delayed and pade:
            ahead, behind = _pades(self.input_delay, pade), _pades(self.output_delay, pade)
            system = behind * system * ahead
            states = [f"x[{k}]" for k in range(system.nstates)]
        return ct.ss(
            system.A, system.B, system.C, system.D, system.dt,
            inputs=inputs, outputs=outputs, states=states, name=_plain(self.name),
        )  # fmt: skip


def python_control() -> Any:
    """python-control, or MissingExtraError. Absolute: flexjoint.simulation.controllers is another."""
    try:
        import control
    except ImportError:
        raise MissingExtraError("python-control", "control") from None
    return control


def zero_order_hold(A: np.ndarray, B: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi (n, n) and Gamma (n, m): x after h seconds is Phi x + Gamma u with u constant (Van Loan 1978)."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = h * A, h * B
    whole = scipy.linalg.expm(block)
    return whole[:n, :n], whole[:n, n:]


def _plain(name: str) -> str:
    return name.replace(".", "_")  # python-control keeps the dot for system.signal


def _pades(delays: np.ndarray, order: int) -> control.StateSpace:
    ct = python_control()
    parts = [ct.ss(ct.tf(*ct.pade(d, order))) if d > 0.0 else ct.ss([], [], [], [[1.0]]) for d in delays]
    return ct.append(*parts) if len(parts) > 1 else parts[0]


def _ticks(delay: float, tick: float) -> tuple[int, float]:
    """Whole ticks of a delay, and the rest in seconds."""
    whole = math.floor(delay / tick + WHOLE)
    rest = delay - whole * tick
    return whole, rest if rest > WHOLE * tick else 0.0


def _sampled(model: LinearModel, tick: float, input_delay: np.ndarray) -> LinearModel:
    """Registers: past commands of each late input; past readings of each late output."""
    n, nu = model.B.shape
    late_in = [_ticks(d, tick) for d in input_delay]
    late_out = [_ticks(d, tick) for d in model.output_delay]
    lengths_in = [whole + (rest > 0.0) for whole, rest in late_in]
    lengths_out = [whole + (rest > 0.0) for whole, rest in late_out]
    first_in = n + np.concatenate([[0], np.cumsum(lengths_in)]).astype(int)
    first_out = first_in[-1] + np.concatenate([[0], np.cumsum(lengths_out)]).astype(int)
    size = int(first_out[-1])
    A, B = np.zeros((size, size)), np.zeros((size, nu))
    C, D = np.zeros((len(model.outputs), size)), np.zeros((len(model.outputs), nu))
    states = list(model.states)

    def put(row: np.ndarray, row_u: np.ndarray, j: int, age: int, value: np.ndarray) -> None:
        """Add the effect of input j as commanded `age` ticks ago."""
        if age == 0:
            row_u[..., j] += value
        else:
            row[..., first_in[j] + age - 1] += value

    @cache
    def hold(h: float) -> tuple[np.ndarray, np.ndarray]:
        return zero_order_hold(model.A, model.B, h)

    @cache
    def ahead(h: float) -> tuple[np.ndarray, np.ndarray]:
        """x after h seconds from now on, in terms of the registers (n, size) and the new command (n, nu)."""
        by_state, by_command = np.zeros((n, size)), np.zeros((n, nu))
        by_state[:, :n] = hold(h)[0]
        for j, (whole, rest) in enumerate(late_in):
            old = min(rest, h)
            phi, gamma = hold(h - old)
            put(by_state, by_command, j, whole, gamma[:, j])
            if old > 0.0:
                put(by_state, by_command, j, whole + 1, phi @ hold(old)[1][:, j])
        return by_state, by_command

    A[:n], B[:n] = ahead(tick)
    for j, length in enumerate(lengths_in):
        shift(A, first_in[j], length)
        if length:
            B[first_in[j], j] = 1.0
        states += [f"{model.inputs[j]}[n-{k + 1}]" for k in range(length)]
    for i, ((_, rest), length) in enumerate(zip(late_out, lengths_out, strict=True)):
        if length == 0:
            C[i, :n], D[i] = model.C[i], model.D[i]
            continue
        shift(A, first_out[i], length)
        by_state, by_command = np.zeros(size), np.zeros(nu)
        if rest > 0.0:
            x, u = ahead(tick - rest)
            by_state, by_command = model.C[i] @ x, model.C[i] @ u
        else:
            by_state[:n] = model.C[i]
        A[first_out[i]], B[first_out[i]] = by_state, by_command
        C[i, first_out[i] + length - 1] = 1.0
        states += [f"{model.outputs[i]}[n-{k + 1}]" for k in range(length)]
    drift = np.zeros(size)
    drift[:n] = zero_order_hold(model.A, model.drift[:, None], tick)[1][:, 0]
    return replace(
        model, A=A, B=B, C=C, D=D, states=tuple(states), drift=drift, dt=tick,
        input_delay=np.zeros(nu), output_delay=np.zeros(len(model.outputs)),
    )  # fmt: skip


def shift(A: np.ndarray, first: int, length: int) -> None:
    """A register that moves on by one place a tick."""
    for k in range(1, length):
        A[first + k, first + k - 1] = 1.0
