"""The contract of an effect, walked over the whole catalogue, and every law against a formula typed here."""

import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import fields
from types import SimpleNamespace as Inputs
from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from support.effect_laws import LAWS

import flexjoint.effects
from flexjoint.effects import (
    SENSOR_CHANNELS,
    Drive,
    Effect,
    Kind,
    Signals,
    Site,
    catalogue,
)

EFFECTS = list(catalogue().values())
every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
SIGNALS = tuple(f.name for f in fields(Signals))
# Typical sizes [SI] of the signals of a joint of some 30 N m; steps and neighbourhoods are relative to them.
SIZE = {
    **{"t": 3, "q": 1, "dq": 2, "theta": 1, "dtheta": 2, "phi": 0.02, "dphi": 0.5, "tau_t": 20},
    **{"tau_m": 30, "tau_m_before": 30, "tau_m_after": 30},
}
INPUT_OF = {Site.COMMAND: "tau_m", Site.DEFLECTION: "phi"}  # what `map` maps; a SENSOR any reading
SEEN = len(SIZE) + 2  # signals, x and z: what changes along a recording
OWN = SEEN + 17  # where an effect's own parameters begin in the flat vector of `inputs`
EDITS = ("edit_drive", "edit_inertial", "edit_gravity")
PIECES = ("map", "slope", "torque", "level", "rate", "delay", *EDITS)


@pytest.fixture(autouse=True)
def floating_point_errors() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield


# --- inputs and outputs as flat vectors: signals, x, z, drive, inertial, gravity, parameters ---------


def sample(effect: Effect, rng: np.random.Generator) -> np.ndarray:
    """One random point: signals of their typical size, parameters within a decade of their default."""
    signals = {name: size * rng.uniform(-1, 1) for name, size in SIZE.items()}
    signals["t"] = abs(signals["t"])
    x = signals[INPUT_OF.get(effect.site, "q")]
    values = [
        float(np.clip(v, p.low, p.high))
        for p in effect.params
        for v in (p.value * 10 ** rng.uniform(-1, 1, p.size) if p.value else rng.uniform(-1, 1, p.size))
        * (rng.choice((-1, 1)) if p.low < 0 else 1)
    ]
    body = rng.uniform(0.5, 2.0, 4 + 10 + 3)  # drive, inertial, gravity: any numbers of order one
    return np.array([*signals.values(), x, 0.2 * rng.uniform(-1, 1), *body, *values])


def inputs(effect: Effect, vector: Any) -> Inputs:
    """The flat vector (floats or SX) as what the pieces of an effect take."""
    v = list(vector)
    values, at = {}, OWN
    for param in effect.params:
        values[param.name] = v[at] if param.size == 1 else tuple(v[at : at + param.size])
        at += param.size
    body, x, z = v[SEEN:OWN], *v[SEEN - 2 : SEEN]
    s = Signals(**dict(zip(SIGNALS, v[: len(SIGNALS)], strict=True)))
    p = effect.parameters(values)
    return Inputs(s=s, x=x, z=z, drive=Drive(*body[:4]), inertial=body[4:14], gravity=body[14:], p=p)


def piece(effect: Effect, name: str, i: Inputs) -> list[Any]:
    """The outputs of one piece of physics."""
    if name in ("map", "torque", "rate", "level"):
        return [getattr(effect, name)(i.s, i.p, i.x if name == "map" else i.z)]
    if name == "slope":
        return [effect.slope(i.s, i.p)]
    if name == "delay":
        return [effect.delay(i.p)]
    if name == "edit_drive":
        drive = effect.edit_drive(i.drive, i.p)
        return [drive.K, drive.D, drive.B, drive.D_m]
    return list(getattr(effect, name)(i.inertial if name == "edit_inertial" else i.gravity, i.p))


def outputs(effect: Effect, vector: Any) -> list[Any]:
    """The outputs of all pieces that the effect has."""
    i = inputs(effect, vector)
    return [value for name in PIECES if effect.overrides(name) for value in piece(effect, name, i)]


def symbols(effect: Effect) -> ca.SX:
    return ca.SX.sym("v", OWN + sum(p.size for p in effect.params))


def symbolic(effect: Effect) -> ca.Function:
    """The vector -> (outputs, Jacobian) in CasADi."""
    v = symbols(effect)
    out = ca.vertcat(*outputs(effect, ca.vertsplit(v)))
    return ca.Function("f", [v], [out, ca.jacobian(out, v)])


def _ends(i: Inputs, x: float, size: float = 1.0) -> tuple[float, ...]:
    """Distances of a signal (in its size) from the ends of a learned law."""
    return x - i.p.start / size, x - (i.p.start + i.p.span) / size


# Where a law is not differentiable: its distances from there, in typical sizes. Derivatives are not compared
# within NEAR of them.
NEAR = 1e-3
KINKS: dict[str, Callable[[Inputs], tuple[float, ...]]] = {
    "asymmetric_friction": lambda i: (i.s.dtheta / 2,),
    "backlash": lambda i: ((abs(i.x) - i.p.gap / 2) / 0.02,),
    "breakaway_friction": lambda i: (i.s.dtheta / 2,),
    "dahl_friction": lambda i: (i.s.dtheta / 2,),
    "drive_efficiency": lambda i: (i.s.dtheta / 2, i.s.tau_t / 20),
    "end_stop": lambda i: (i.s.q - i.p.position, i.p.position),
    "learned_deflection": lambda i: _ends(i, i.s.theta),
    "learned_link_torque": lambda i: _ends(i, i.s.q),
    "learned_torque": lambda i: _ends(i, i.s.dtheta / 2, 2),
    "learned_surface": lambda i: (
        *_ends(i, i.s.dtheta / 2, 2),
        i.s.theta - i.p.other_start,
        i.s.theta - (i.p.other_start + i.p.other_span),
    ),
    "load_friction": lambda i: (i.s.tau_t / 20,),
    "quadratic_drag": lambda i: (i.s.dq / 2,),
    "spring_hysteresis": lambda i: (i.s.dphi / 0.5,),
    "torque_saturation": lambda i: ((abs(i.x) - i.p.limit) / 30,),
    "torque_speed_limit": lambda i: ((abs(i.x + i.p.drop * i.s.dtheta) - i.p.stall) / 30,),
}


def smooth_points(effect: Effect, count: int, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    points = [sample(effect, rng) for _ in range(count)]
    kinks = KINKS.get(effect.name, lambda i: ())
    kept = [v for v in points if all(abs(d) > NEAR for d in kinks(inputs(effect, v)))]
    assert len(kept) > 0.9 * count
    return kept


# --- the laws of docs/reference/formats.md -----------------------------------------------------------
@every_effect
def test_law_is_that_of_the_table(effect: Effect) -> None:
    units, laws = LAWS[effect.name]
    assert units == ", ".join(f"{p.name} {p.unit}" for p in effect.params)
    assert set(laws) == {name for name in PIECES if effect.overrides(name)}
    for vector in smooth_points(effect, 60, seed=1):
        i = inputs(effect, vector)
        for name, law in laws.items():
            # 1e-12 of the numbers that enter: the two formulas round differently
            size = 1.0 + float(np.max(np.abs(vector)))
            np.testing.assert_allclose(piece(effect, name, i), np.atleast_1d(law(i)), 1e-12, 1e-12 * size)


def test_catalogue_is_the_table_and_the_files() -> None:
    assert set(LAWS) == set(catalogue())
    files = {m.name for m in pkgutil.iter_modules(flexjoint.effects.__path__) if not m.name.startswith("_")}
    assert files == set(catalogue())


# --- the contract ------------------------------------------------------------------------------------


@every_effect
def test_declares_itself(effect: Effect) -> None:
    assert (effect.__doc__ or "").strip().endswith(".") and effect.law and effect.reference
    assert effect.params and effect.against in SIGNALS
    assert isinstance(effect.site, Site) and isinstance(effect.kind, Kind)
    assert (effect.kind is Kind.SENSOR) <= (effect.site is Site.SENSOR)
    for param in effect.params:
        assert param.name and param.unit and param.symbol
        assert param.low <= param.value <= param.high and np.isfinite([param.low, param.high]).all()
        assert param.null is None or param.low <= param.null <= param.high
    for formula in (effect.law, *(p.symbol for p in effect.params)):
        MathTextParser("path").parse(f"${formula}$")  # as the report draws it
    assert effect.nulls, "one parameter at least must say where the effect is absent"
    assert set(effect.contains) <= set(catalogue()) - {effect.name}
    assert effect.overrides("rate") == bool(effect.states)
    assert effect.overrides("delay") == (effect.max_delay > 0)
    if effect.overrides("delay"):
        assert effect.max_delay == max(p.high for p in effect.params if p.name == "delay")


@every_effect
def test_typical_sizes_have_sources(effect: Effect) -> None:
    for one in effect.typical:
        assert any(letter.isdigit() for letter in one.size) and not one.size.endswith(".")
        assert one.source.name and one.source.address.startswith("https://")
        assert not set("[]() ") & set(one.source.address)  # it is a link's target in Markdown
    assert len(set(effect.typical)) == len(effect.typical)


@every_effect
def test_sensor_channels(effect: Effect) -> None:
    for values in [{w.name: c} for w in effect.words for c in w.choices] or [{}]:
        channels = effect.channels(effect.parameters(values))
        assert bool(channels) == (effect.site is Site.SENSOR) and set(channels) <= set(SENSOR_CHANNELS)


@every_effect
def test_numpy_is_casadi(effect: Effect) -> None:
    function, rng = symbolic(effect), np.random.default_rng(2)
    for _ in range(3):
        rows = np.array([sample(effect, rng) for _ in range(40)])
        rows[:, SEEN:] = rows[0, SEEN:]  # one set of parameters
        rows[0, :SEEN] = 0.0  # at rest
        # over a whole recording at once: signals are arrays, parameters numbers
        arrays = outputs(effect, [*rows[:, :SEEN].T, *rows[0, SEEN:].tolist()])
        for column in arrays:
            assert np.shape(column) in ((), (len(rows),)) and np.all(np.isfinite(column))
        for n, row in enumerate(rows):
            by_float = np.array(outputs(effect, row.tolist()), dtype=float)
            by_array = np.array([np.broadcast_to(column, len(rows))[n] for column in arrays])
            # 1e-12: sin and exp of the two libraries differ by rounding only
            size = 1e-12 * (1.0 + float(np.max(np.abs(row))))
            np.testing.assert_allclose(by_array, by_float, 1e-12, size)
            np.testing.assert_allclose(np.array(function(row)[0]).ravel(), by_float, 1e-12, size)


@every_effect
def test_finite_at_all_bounds_and_no_negative_friction(effect: Effect) -> None:
    function, rng = symbolic(effect), np.random.default_rng(3)
    for _ in range(20):
        vector = sample(effect, rng)
        vector[OWN:] = [rng.choice((p.low, p.high)) for p in effect.params for _ in range(p.size)]
        for at in (vector, np.where(np.arange(len(vector)) < SEEN, 0.0, vector)):
            assert np.all(np.isfinite(np.array(outputs(effect, at.tolist()), dtype=float)))
            assert np.all(np.isfinite(np.array(function(at)[1]))), "derivatives too"
            assert effect.level(inputs(effect, at).s, inputs(effect, at).p, 0.5) >= 0.0


@every_effect
def test_absent_at_null(effect: Effect) -> None:
    rng = np.random.default_rng(4)
    z = effect.states[0] if effect.states else 0.0
    for _ in range(40):
        i = inputs(effect, sample(effect, rng))
        i.p = i.p._replace(**{p.name: p.null if p.size == 1 else (p.null,) * p.size for p in effect.nulls})
        if effect.overrides("steady_state"):  # an absent effect's state follows its signals at once
            z = effect.steady_state(i.s, i.p)
        assert effect.map(i.s, i.p, i.x) == i.x
        assert effect.slope(i.s, i.p) == (1.0 if effect.site is Site.DEFLECTION else 0.0)
        assert effect.level(i.s, i.p, z) == 0.0 and effect.delay(i.p) == 0.0
        assert effect.torque(i.s, i.p, z) == 0.0
        z += 1e-6 * effect.rate(i.s, i.p, z)  # the torque must stay 0 whatever the state has seen
        assert effect.edit_drive(i.drive, i.p) == i.drive
        assert list(effect.edit_inertial(i.inertial, i.p)) == i.inertial
        assert list(effect.edit_gravity(i.gravity, i.p)) == i.gravity


@every_effect
def test_slope_is_the_derivative(effect: Effect) -> None:
    i = inputs(effect, ca.vertsplit(v := symbols(effect)))
    deflects = effect.site is Site.DEFLECTION
    through = effect.map(i.s, i.p, i.s.phi) if deflects else effect.torque(i.s, i.p, i.z)
    derivative = ca.jacobian(ca.SX(through), i.s.phi)
    function = ca.Function("slope", [v], [derivative, ca.SX(effect.slope(i.s, i.p))])
    for vector in smooth_points(effect, 40, seed=6):
        expected, slope = function(vector)
        assert float(slope) == pytest.approx(float(expected), rel=1e-12)  # the same polynomial


@every_effect
def test_derivatives_are_finite_differences(effect: Effect) -> None:
    function = symbolic(effect)
    points = smooth_points(effect, 25, seed=7)
    values = np.array([outputs(effect, v.tolist()) for v in points], dtype=float)
    largest = np.max(np.abs(values), axis=0)
    for vector in points:
        exact = np.array(function(vector)[1])
        size = np.abs(vector)
        signals = slice(len(SIZE))
        size[signals] = np.maximum(size[signals], 0.01 * np.array(list(SIZE.values())))
        size = np.maximum(size, 1e-6)
        for n, step in enumerate(2e-6 * size):
            # fourth-order central difference: the truncation error stays below 1e-9 for 100 cycles a turn
            at = [vector + k * step * np.eye(len(vector))[n] for k in (-2, -1, 1, 2)]
            f = [np.array(outputs(effect, v.tolist()), dtype=float) for v in at]
            difference = (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * step)
            # rounding: eps/2e-6 of the output, times up to 100 where a sine's argument is that large
            allowed = 1e-6 * np.abs(exact[:, n]) + 1e-8 * largest / size[n]
            assert np.all(np.abs(exact[:, n] - difference) <= allowed), (vector, n)
