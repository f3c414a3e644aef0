"""What an effect refuses from a user, where it lets a fit start, and what its formula alone does not show."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import flexjoint.effects
from flexjoint.core.errors import FlexJointError, ModelError, UnknownNameError
from flexjoint.diagnosis.search.ripples import strongest
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import SENSOR_CHANNELS, Effect, Planned, Signals, Site, catalogue, find
from flexjoint.effects import effect as make_effect
from flexjoint.effects._starts import PHASES

EFFECTS = list(catalogue().values())
every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)


@pytest.fixture(autouse=True)
def floating_point_errors() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield


def joint_of(effect: Effect) -> str | None:
    return None if effect.whole_robot else "elbow"


# --- refusals ----------------------------------------------------------------------------------------


@every_effect
def test_defaults_are_accepted(effect: Effect) -> None:
    planned = make_effect(effect.name, joint_of(effect))
    assert planned.key == (effect.name, joint_of(effect))
    assert set(planned.values) == {p.name for p in effect.params} | {w.name for w in effect.words}


@every_effect
def test_unknown_parameter_lists_the_valid_ones(effect: Effect) -> None:
    for attempt in (
        lambda: effect.parameters({"wrong": 1.0}),
        lambda: make_effect(effect.name, joint_of(effect), wrong=1.0),
    ):
        with pytest.raises(UnknownNameError, match="'wrong'") as caught:
            attempt()
        assert all(p.name in str(caught.value) for p in effect.params)


@every_effect
def test_out_of_bounds_and_not_numbers_are_refused(effect: Effect) -> None:
    for param in effect.params:
        inside = (param.value,) * param.size
        beyond = (math.nextafter(param.low, -math.inf), math.nextafter(param.high, math.inf))
        for bad in (*beyond, float("nan"), float("inf"), "a lot", None):
            value = bad if param.size == 1 else (*inside[1:], bad)
            with pytest.raises(ModelError, match=rf"{effect.name}.{param.name}: expected a number") as caught:
                Planned.of(effect.name, joint_of(effect), {param.name: value})
            assert f"[{param.low:g}, {param.high:g}] {param.unit}" in str(caught.value)
        for shape in ([*inside, 0.0], [], *([0.0] if param.size > 1 else [])):
            with pytest.raises(ModelError, match=rf"{effect.name}.{param.name}: expected"):
                Planned.of(effect.name, joint_of(effect), {param.name: shape})
        for edge in (param.low, param.high):
            Planned.of(
                effect.name, joint_of(effect), {param.name: edge if param.size == 1 else (edge,) * param.size}
            )


@every_effect
def test_joint_or_whole_robot(effect: Effect) -> None:
    with pytest.raises(ModelError, match="whole robot" if effect.whole_robot else "name one"):
        make_effect(effect.name, "elbow" if effect.whole_robot else None)


def test_unknown_words_and_effects_list_the_valid_ones() -> None:
    with pytest.raises(
        UnknownNameError, match=r"channel of sensor_delay 'tau_m'.*valid: None, q, tau_t, theta"
    ):
        make_effect("sensor_delay", "elbow", channel="tau_m")
    with pytest.raises(UnknownNameError, match=r"did you mean 'backlash'\?.*valid: asymmetric_friction, "):
        make_effect("backlsh", "elbow")
    assert issubclass(UnknownNameError, FlexJointError)


def test_effect_not_named_after_its_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rust.py").write_text(
        "from flexjoint.effects import Effect\n\n\nclass Corrosion(Effect):\n    '''Rust.'''\n"
    )
    monkeypatch.setattr(flexjoint.effects, "__path__", [*flexjoint.effects.__path__, str(tmp_path)])
    with pytest.raises(ModelError, match=r"effects/rust.py defines corrosion"):
        catalogue.__wrapped__()
    sys.modules.pop("flexjoint.effects.rust")
    vars(flexjoint.effects).pop("rust")


# --- starts of a fit ---------------------------------------------------------------------------------

RATE = 500.0  # [Hz]


def recording(seed: int, centre: float = 0.1) -> Signals:
    """A joint of some 30 N m moved by a few sines for 10 s: signals (N,)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 1.0 / RATE)
    w = 2 * np.pi * rng.uniform(0.15, 1.5, (5, 1))
    sines = np.array([[0.8], [0.5], [0.3], [0.2], [0.1]]) * np.exp(
        1j * (w * t + rng.uniform(-3.1, 3.1, (5, 1)))
    )
    q, dq, ddq = centre + sines.imag.sum(0), (1j * w * sines).imag.sum(0), (-w * w * sines).imag.sum(0)
    tau_t = 15 * np.sin(q) + 0.4 * ddq
    phi = tau_t / 300
    dphi = np.gradient(phi, t)
    theta, dtheta = q + phi, dq + dphi
    tau_m = tau_t + 0.1 * ddq + dtheta
    return Signals(t=t, q=q, dq=dq, theta=theta, dtheta=dtheta, phi=phi, dphi=dphi, tau_t=tau_t, tau_m=tau_m)


def standing(s: Signals, at: float) -> Signals:
    """The same time, nothing moves."""
    still = np.full_like(s.t, at)
    zero = np.zeros_like(s.t)
    return Signals(
        t=s.t, q=still, dq=zero, theta=still, dtheta=zero, phi=zero, dphi=zero, tau_t=zero, tau_m=zero
    )


@every_effect
def test_starts_are_deterministic_distinct_and_inside_the_bounds(effect: Effect) -> None:
    moving = recording(1)
    for s in (
        moving,
        recording(2, centre=3.0),
        recording(3, -3.0),
        standing(moving, 0.0),
        standing(moving, -4.0),
    ):
        starts = effect.starts(s)
        assert starts and starts == effect.starts(s)
        assert len({tuple(start.items()) for start in starts}) == len(starts)
        assert len({tuple(start) for start in starts}) == 1, "all starts name the same parameters"
        for start in starts:
            Planned.of(effect.name, joint_of(effect), start)  # names, numbers, bounds
    assert len(effect.starts(moving)) <= 200


def response(effect: Effect, s: Signals, values: dict[str, float]) -> np.ndarray:
    """What the effect changes in the signal on which it acts, over the whole recording (N,)."""
    p = effect.parameters(values)
    if effect.overrides("shafts"):  # at one speed of all: where only one shaft is, at its own
        return np.sum([response(law, s, dict(numbers)) for law, numbers in effect.shafts(p)], axis=0)
    if effect.overrides("delay"):
        x = s.tau_m if effect.site is Site.COMMAND else s.q
        return np.interp(s.t - p.delay, s.t, x) - x
    if effect.overrides("map"):
        x = {Site.COMMAND: s.tau_m, Site.DEFLECTION: s.phi, Site.SENSOR: s.q}[effect.site]
        return effect.map(s, p, x) - x
    if effect.overrides("level"):
        z = states(effect, s, p) if effect.states else 0.0
        return effect.level(s, p, z) * np.sign(s.dtheta)
    if not effect.states:
        return effect.torque(s, p, 0.0) * np.ones_like(s.t)
    return effect.torque(s, p, states(effect, s, p))


def states(effect: Effect, s: Signals, p: Any) -> np.ndarray:
    """The state over time (N,): at given signals each law is dz = b - a z, which is stepped exactly."""
    b = effect.rate(s, p, np.zeros_like(s.t))
    a = b - effect.rate(s, p, np.ones_like(s.t))
    left = np.exp(np.maximum(-a / RATE, -300.0))
    gained = b * np.where(a > 1e-12, (1 - left) / np.maximum(a, 1e-12), 1 / RATE)
    z = np.full_like(s.t, np.ravel(effect.steady_state(s, p))[0])
    for n in range(1, len(z)):
        before = z[n - 1] if abs(z[n - 1]) > 1e-150 else 0.0  # what has faded does not underflow
        z[n] = left[n] * before + gained[n]
    return z


# What is planted: the shape and non-linear parameters far from any start of the grids.
PLANTED: dict[str, tuple[dict[str, float], ...]] = {
    "backlash": ({"gap": 0.011}, {"gap": 0.0027}, {"gap": 0.045}),
    "breakaway_friction": ({"level": 1, "distance": 0.4}, {"level": 3, "distance": 0.02}),
    "cable_spring": ({"stiffness": 5, "rest": -0.7}, {"stiffness": 0.3, "rest": 9.0}),
    "cogging": (
        {"amplitude": 0.3, "cycles": 12, "phase": -2.9},
        {"amplitude": 0.3, "cycles": 1, "phase": 0.4},
        {"amplitude": 0.05, "cycles": 47.5, "phase": 1.1},
    ),
    "current_lag": ({"time_constant": 0.0022}, {"time_constant": 0.05}),
    "dahl_friction": ({"level": 0.5, "scale": 0.0056}, {"level": 2, "scale": 0.05}),
    "encoder_eccentricity": ({"amplitude": 1e-3, "phase": 3.0}, {"amplitude": 0.01, "phase": -1.0}),
    "encoder_ripple": (
        {"amplitude": 1e-4, "cycles": 131.3, "phase": 1.0},
        {"amplitude": 1e-3, "cycles": 40.0, "phase": -3.0},
    ),
    "end_stop": (
        {"position": 0.9, "stiffness": 300},
        {"position": -0.77, "stiffness": 3000},
        {"position": 0.3, "stiffness": 50},
    ),
    "friction_drift": ({"level": 1, "time_constant": 1.7}, {"level": 1, "time_constant": 20}),
    "periodic_disturbance": (
        {"amplitude": 0.5, "frequency": 4.3, "phase": 2.0},
        {"amplitude": 0.1, "frequency": 23.0, "phase": -1.0},
    ),
    "rough_spot": (
        {"level": 1, "position": 0.41, "width": 0.08},
        {"level": 1, "position": -0.6, "width": 0.4},
    ),
    "sensor_delay": ({"delay": 0.0057}, {"delay": 0.028}),
    "spring_creep": ({"stiffness": 30, "time_constant": 0.8}, {"stiffness": 10, "time_constant": 5}),
    "spring_hysteresis": ({"level": 1, "scale": 0.0018}, {"level": 1, "scale": 0.02}),
    "stribeck_friction": (
        {"level": 1, "static_extra": 0.7, "velocity": 0.07},
        {"level": 1, "static_extra": 0.7, "velocity": 0.9},
    ),
    "torque_delay": ({"delay": 0.0007}, {"delay": 0.013}),
    "magnetic_saturation": ({"saturation": 0.05}, {"saturation": 0.2}),
    "torque_saturation": ({"limit": 17.0}, {"limit": 5.0}),
    "torque_speed_limit": ({"stall": 20.0, "drop": 4.0}, {"stall": 64.0, "drop": 4.0}),
    "transmission_error": (
        {"amplitude": 5e-4, "cycles": 2, "phase": 2.0},
        {"amplitude": 5e-4, "cycles": 60, "phase": 0},
    ),
}


def test_gaps_are_looked_for_up_to_where_a_load_closes_them() -> None:
    """A load that pulls one way bends a spring far more than its changes do, and a gap may be as wide."""
    t = np.linspace(0.0, 10.0, 500)
    zeros = np.zeros_like(t)
    s = Signals(t, q=zeros, theta=zeros, phi=-6e-3 + 3e-4 * np.sin(t), tau_t=zeros, dphi=zeros)
    gaps = [start["gap"] for start in catalogue()["backlash"].starts(s)]
    assert min(gaps) < 5e-4 and 8e-3 < max(gaps) < 2.0 * 6.3e-3


def test_every_effect_with_starts_is_planted() -> None:
    assert set(PLANTED) == {
        e.name for e in EFFECTS if (e.overrides("starts") or e.repeats) and not e.for_rigid
    }  # how a rigid joint bends is no law of its signals: test_bending.py


def periodic(effect: Effect, s: Signals, left: np.ndarray) -> list[dict[str, float]]:
    """Where the search starts that for a law that repeats, from what is left (N,)."""
    if not effect.repeats:
        return []
    unit = 2 * np.pi if effect.against == "t" else 1.0  # Hz
    cycles = strongest(getattr(s, effect.against), left, s.t, USUAL.search)
    return [{effect.repeats: n / unit, "phase": phase} for n in cycles for phase in PHASES]


@pytest.mark.parametrize(
    ("name", "planted"), [(n, v) for n, all_values in PLANTED.items() for v in all_values], ids=str
)
def test_local_search_from_the_best_start_finds_what_was_planted(
    name: str, planted: dict[str, float]
) -> None:
    effect, s = find(name), recording(4)
    target = response(effect, s, planted)
    names = list(planted)
    bounds = {p.name: p for p in effect.params}
    scale = np.sqrt(np.mean(target**2))
    assert scale > 0

    def error(values: dict[str, float]) -> np.ndarray:
        with np.errstate(all="raise"):
            return (response(effect, s, values) - target) / scale

    def with_amplitudes(start: dict[str, float]) -> dict[str, float]:
        """The start completed by the least-squares amplitudes: the law is linear in them."""
        linear = [n for n in names if n not in start]
        if not linear:
            return start
        columns = [response(effect, s, {**start, **{m: float(m == n) for m in linear}}) for n in linear]
        found = np.linalg.lstsq(np.array(columns).T, target, rcond=None)[0]
        limited = {
            n: float(np.clip(v, bounds[n].low, bounds[n].high)) for n, v in zip(linear, found, strict=True)
        }
        return {**start, **limited}

    starts = [with_amplitudes(start) for start in (*effect.starts(s), *periodic(effect, s, target))]
    best = min(starts, key=lambda values: float(np.sum(error(values) ** 2)))
    size = np.array([max(abs(best[n]), 1e-6 if n != "phase" else 1.0) for n in names])
    with np.errstate(under="ignore"):  # of the solver's own products, on some processors
        fit = least_squares(
            lambda x: error(dict(zip(names, x * size, strict=True))),
            np.array([best[n] for n in names]) / size,
            bounds=(
                [bounds[n].low / k for n, k in zip(names, size, strict=True)],
                [bounds[n].high / k for n, k in zip(names, size, strict=True)],
            ),
            xtol=1e-12,
            ftol=1e-12,
        )
    found = dict(zip(names, fit.x * size, strict=True))
    for n, value in planted.items():
        error_of = (found[n] - value + np.pi) % (2 * np.pi) - np.pi if bounds[n].wraps else found[n] - value
        # noise-free, so only the search's own tolerance and the kinks between samples are left
        assert abs(error_of) <= 2e-3 * max(abs(value), 1.0 if bounds[n].wraps else 0.0), (n, found, best)


# --- special cases -----------------------------------------------------------------------------------

# effect: the values at which it is the simpler one, that one's values, and the relative difference left:
# 0 where the case is exact, else what the limit leaves (Dahl: its first sample of 5000, where z is still 0)
SPECIAL: dict[tuple[str, str], tuple[dict[str, float], dict[str, float], float]] = {
    ("asymmetric_friction", "motor_coulomb_friction"): (
        {"level_positive": 0.7, "level_negative": 0.7},
        {"level": 0.7},
        0,
    ),
    ("differential_friction", "coupled_friction"): (
        {
            "level_sum": 0.7,
            "coefficient_sum": 0.3,
            "level_difference": 0.0,
            "coefficient_difference": 0.0,
        },
        {"level": 0.7, "coefficient": 0.3},
        0,
    ),
    ("stribeck_friction", "motor_coulomb_friction"): ({"level": 0.7, "static_extra": 0}, {"level": 0.7}, 0),
    ("friction_drift", "motor_coulomb_friction"): (
        {"level": 0.7, "time_constant": 1e5},
        {"level": 0.7},
        1e-4,
    ),
    ("dahl_friction", "motor_coulomb_friction"): ({"level": 0.7, "scale": 1e-6}, {"level": 0.7}, 0.015),
    ("rough_spot", "motor_coulomb_friction"): ({"level": 0.7, "width": 100}, {"level": 0.7}, 1e-3),
    ("drive_efficiency", "load_friction"): (
        {"loss_driving": 0.2, "loss_backdriving": 0.2},
        {"coefficient": 0.2},
        0,
    ),
    ("torque_speed_limit", "torque_saturation"): ({"stall": 9, "drop": 0}, {"limit": 9}, 0),
}


def test_contains_are_special_cases() -> None:
    assert set(SPECIAL) == {(e.name, simpler) for e in EFFECTS for simpler in e.contains}
    s = recording(5)
    for (name, simpler), (values, simpler_values, left) in SPECIAL.items():
        general, special = response(find(name), s, values), response(find(simpler), s, simpler_values)
        if find(name).states:
            general = -general  # a torque on the motor; a level resists
        difference = np.sqrt(np.mean((general - special) ** 2) / np.mean(special**2))
        assert difference <= left, (name, simpler, difference)


# --- what no formula shows -------------------------------------------------------------------


def test_friction_at_rest_takes_the_level_of_the_push() -> None:
    asymmetric, gear = find("asymmetric_friction"), find("drive_efficiency")
    p = asymmetric.parameters({"level_positive": 3.0, "level_negative": 2.0})
    assert asymmetric.level(Signals(tau_m=5.0, tau_t=1.0), p, 0.0) == 3.0
    assert asymmetric.level(Signals(tau_m=-5.0, tau_t=1.0), p, 0.0) == 2.0
    p = gear.parameters({"loss_driving": 0.1, "loss_backdriving": 0.3})
    assert gear.level(Signals(tau_m=15.0, tau_t=10.0), p, 0.0) == pytest.approx(1.0)  # lifts its load
    assert gear.level(Signals(tau_m=5.0, tau_t=10.0), p, 0.0) == pytest.approx(3.0)  # lets it down


@pytest.mark.parametrize("name", ["dahl_friction", "spring_hysteresis", "spring_creep"])
def test_states_dissipate(name: str) -> None:
    effect = find(name)
    s = Signals(t=np.arange(0, 20, 1 / RATE))
    speed = np.cos(2 * np.pi * 0.5 * s.t)
    s.dtheta = s.dphi = speed
    z = states(effect, s, p := effect.parameters({"scale": 0.05} if name != "spring_creep" else {}))
    torque = effect.torque(s, p, z) * (-1 if effect.site is Site.MOTOR else 1)  # that against the motion
    assert np.sum(torque * speed) > 0  # over whole periods nothing stored is left
    if name == "spring_creep":
        return
    # a stroke of 0.64 rad is 13 scales: z reaches its level, from below
    assert 0.99 * p.level < np.max(np.abs(z)) <= p.level


def test_creep_gives_way_to_the_slow_stiffness() -> None:
    creep = find("spring_creep")
    p = creep.parameters({"stiffness": 10.0, "time_constant": 1.0})
    s = Signals(t=np.arange(0, 12, 1 / RATE))
    s.dphi = np.where(s.t < 0.1, 1.0, 0.0)  # 0.1 rad within 0.1 s, then held
    torque = creep.torque(s, p, states(creep, s, p))
    # a ramp of length r leaves k phi T/r (1 - exp(-r/T)); the sampled ramp is one step off (2 %)
    assert torque.max() == pytest.approx(10.0 * 1.0 * (1 - np.exp(-0.1)), rel=0.03)
    assert abs(torque[-1]) < 1e-4 * torque.max()


def test_channels_of_each_sensor_effect() -> None:
    def channels(name: str, **values: str | None) -> tuple[str, ...]:
        return find(name).channels(find(name).parameters(values))

    assert channels("link_encoder_offset") == ("q",)
    assert channels("motor_encoder_offset") == ("theta",)
    assert channels("torque_sensor_offset") == channels("torque_sensor_gain") == ("tau_t",)
    assert channels("encoder_eccentricity") == channels("encoder_eccentricity", channel="q") == ("q",)
    assert channels("encoder_eccentricity", channel="theta") == ("theta",)
    assert channels("sensor_delay") == SENSOR_CHANNELS
    assert channels("sensor_delay", channel="theta") == ("theta", "dtheta")
