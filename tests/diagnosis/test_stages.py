"""The stages of the diagnosis, physics by physics: noise, filter, inverse dynamics, completion, whitening."""

from __future__ import annotations

import json
import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from planting import PERFECT, ROBOTS, Planted, Recorded, SensorSet, plant
from planting.machine.sensing import ALL_CHANNELS, robot_noise
from support.diagnose_cases import Case, as_recording, found_in, nominal, summary

from flexjoint.core.errors import RecordingError, UnknownNameError
from flexjoint.diagnosis.balances.balances import Balances
from flexjoint.diagnosis.balances.motion import Motion, along, reconstruct
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.nuisance import inertial_directions
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.signals.signals import make_filter, prepare
from flexjoint.effects import Planned, catalogue
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.robot import robot

DOCS = Path(__file__).parents[2] / "docs" / "reference" / "formats.md"
QUANTUM = 2 * np.pi / 2**18  # rad, the planting's encoders
GAP = Planted("backlash", "swing", {"gap": 0.009})


@cache
def healthy(case: Case) -> Recorded:
    return case.with_causes()


def motion_of(name: str, recorded: Recorded) -> Motion:
    recording = as_recording(recorded)
    return reconstruct(nominal(name), prepare(nominal(name), recording), recording)


# --------------------------------------------------------------------------- noise
@pytest.mark.parametrize("excitation", ["rich", "slow"])
@pytest.mark.parametrize("name", ["lever", "turret", "crane", "gimbal"])
def test_sensor_noise_is_predicted_from_the_readings(name: str, excitation: str) -> None:
    """Encoder noise of 0.6 to 1.2 quanta here, so that noise and rounding are both at work."""
    readings = prepare(nominal(name), as_recording(healthy(Case(name, excitation, 3))))
    planted = robot_noise(name)

    for channel, rounding in (("q", QUANTUM), ("theta", QUANTUM), ("tau_t", 0.0)):
        expected = math.hypot(planted[channel], rounding / math.sqrt(12))
        # fourth differences of 6000 samples know a standard deviation to 2 %
        assert readings.noise[channel] == pytest.approx(expected, rel=0.1), channel


def test_an_encoder_that_only_rounds_has_the_noise_of_rounding() -> None:
    rounding = SensorSet(noise=PERFECT.noise, resolution=1e-4, noisy_feedback=False)
    recorded = plant(ROBOTS / "turret.yaml", [], "rich", 6.0, 5, rounding)

    noise = prepare(nominal("turret"), as_recording(recorded)).noise

    # slow passages round the same way many times in a row, which fourth differences see less of
    assert noise["theta"] == pytest.approx(1e-4 / math.sqrt(12), rel=0.15)


# --------------------------------------------------------------------------- filter
@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_filters_derivatives_are_those_of_the_signal(order: int) -> None:
    """A Gaussian of deviation sigma passes sin(w t) with the gain exp(-(w sigma)^2 / 2), and commutes with
    d/dt."""
    period, sigma = 0.002, 0.005
    t = period * np.arange(2000)
    window = make_filter(t.size, period, sigma)
    waves = [(2.0, 3.0, 0.4), (0.3, 40.0, -1.0), (0.05, 200.0, 2.0)]  # amplitude, rad/s, phase
    x = sum(a * np.sin(w * t + c) for a, w, c in waves)
    gains = [np.exp(-0.5 * (w * sigma) ** 2) for _, w, _ in waves]
    expected = sum(
        g * a * w**order * np.sin(w * t + c + order * np.pi / 2)
        for g, (a, w, c) in zip(gains, waves, strict=True)
    )

    inner = slice(
        int(USUAL.signals.edge_deviations * sigma / period),
        -int(USUAL.signals.edge_deviations * sigma / period),
    )

    # 8 sigma from an edge the window has fallen to 1e-14; a derivative magnifies by 1 / sigma
    assert window.smooth(x, order)[inner] == pytest.approx(expected[inner], abs=1e-9 / sigma**order)


def test_shares_of_the_window_add_up() -> None:
    window = make_filter(1000, 0.002, 0.005)
    x = np.cumsum(np.random.default_rng(1).standard_normal(1000)) / 30

    twice = window.smooth_share(window.smooth_share(x, 0.25), 0.75)

    inner = slice(60, -60)  # the ends are padded anew each time
    assert twice[inner] == pytest.approx(window.smooth(x)[inner], abs=1e-9)


# --------------------------------------------------------------------------- rigid-body torques
def test_filtered_torques_are_those_of_the_true_motion() -> None:
    """F RNEA(q, q', q'') of an analytic motion against what `along` makes of samples of q alone."""
    arm = nominal("gimbal")
    period, sigma = 0.002, 0.004
    t = period * np.arange(3000)
    window = make_filter(t.size, period, sigma)
    amplitude, speed = np.array([0.8, 0.6, 0.9]), 2 * np.pi * np.array([1.1, 2.3, 1.7])
    angle = np.multiply.outer(t, speed) + np.array([0.3, 1.0, 2.0])
    q, dq, ddq = (amplitude * speed**k * np.sin(angle + k * np.pi / 2) for k in range(3))
    body = PinBody(arm.model)

    true = window.smooth(body.rnea_batch(q, dq, ddq).T)
    plain = body.rnea_batch(*(window.smooth(q.T, k).T for k in range(3))).T
    ours = along(arm, window, q.T, {}).tau

    inner = slice(100, -100)
    scale = np.std(true[:, inner], axis=1)
    plain_error, our_error = (np.max(np.abs(x - true)[:, inner], axis=1) / scale for x in (plain, ours))
    # the error of second order in the window's deviation is gone; that of fourth order, (w sigma)^2 smaller,
    # is left, and (2 pi 2.3 Hz 4 ms)^2 = 0.003, times the few harmonics that RNEA makes
    assert np.all(our_error < 0.1 * plain_error)
    assert np.all(our_error < 1e-4)


# --------------------------------------------------------------------------- completion
def without(*channels: str) -> SensorSet:
    kept = tuple(c for c in ALL_CHANNELS if c not in channels)
    return SensorSet(channels=kept, noise=PERFECT.noise, resolution=0.0)


@pytest.mark.parametrize(
    ("missing", "given_up", "way"),
    [
        ("q", ("q", "dq", "tau_t"), "the link driven by its motor"),
        ("q", ("q", "dq"), "the torque sensor"),
        ("theta", ("theta", "dtheta", "tau_t"), "inverse dynamics of the link"),
        ("theta", ("theta", "dtheta"), "the torque sensor"),
    ],
    ids=lambda x: "-".join(x) if isinstance(x, tuple) else None,
)
@pytest.mark.parametrize("name", ["lever", "crane"])
def test_a_missing_angle_is_completed(name: str, missing: str, given_up: tuple[str, ...], way: str) -> None:
    recorded = plant(ROBOTS / f"{name}.yaml", [], "rich", 6.0, 17, without(*given_up))

    motion = motion_of(name, recorded)

    true = recorded.true[missing].T
    phi = (recorded.true["theta"] - recorded.true["q"]).T
    valid = motion.readings.valid
    error = np.std((getattr(motion, missing) - true)[:, valid], axis=1)
    # of the deflection, the filter (4 ms) and the linear steps take less than 1 % at 2.4 Hz
    assert np.all(error < 0.01 * np.std(phi[:, valid], axis=1)), way
    assert motion.missing == tuple((missing, i) for i in range(len(true)))


# --------------------------------------------------------------------------- whitening
def whitened(name: str, recorded: Recorded) -> tuple[Balances, whitening.Whitening]:
    balances = Balances(motion_of(name, recorded))
    valid = balances.motion.readings.valid
    load = np.sqrt(np.mean(balances.motion.rigid.tau[:, valid] ** 2, axis=1))
    return balances, whitening.make(balances, load[[row.joint for row in balances.rows]], ())


def energy(name: str, recorded: Recorded) -> tuple[float, np.ndarray]:
    """Energy per degree of freedom of the whitened residual, and per sample and balance. Where links without
    encoder start, and how fast, no reading tells: what that explains is taken out."""
    balances, made = whitened(name, recorded)
    y = made.apply(balances.residual(()))
    starts = [made.white(made.band_of(rows)).ravel() for rows in balances.missing_links.free()]
    if starts:
        free = np.linalg.lstsq(np.transpose(starts), y.ravel(), rcond=None)[0]
        y = y - (free @ np.array(starts)).reshape(y.shape)
    return float(np.sum(y**2) / (made.time.size * made.freedom)), np.mean(y**2, axis=1)


@pytest.mark.parametrize(
    "case",
    [
        Case("lever", "rich", 4),
        Case("turret", "slow", 5),
        Case("crane", "rich", 6),
        Case("crane", "steps", 7),
        Case("lever", "rich", 8, "encoders"),
        Case("crane", "rich", 9, "motor_only"),
        Case("crane", "rich", 10, "noisy_feedback"),
    ],
    ids=lambda c: c.name,
)
def test_a_healthy_residual_is_white_noise_of_energy_one(case: Case) -> None:
    per_freedom, _ = energy(case.robot, healthy(case))

    # some 1500 samples a balance: chance makes 3 %; the noise levels are known to 2 %
    assert per_freedom == pytest.approx(1.0, abs=0.1)


def test_the_ends_of_a_record_are_no_louder_than_the_rest() -> None:
    """Whitening remembers for some samples what was cut off there."""
    ends = []
    for case in (
        Case("lever", "steps", 4),
        Case("turret", "slow", 5),
        Case("turret", "steps", 9, "motor_only"),
    ):
        balances, made = whitened(case.robot, healthy(case))
        y = made.apply(balances.residual(()))
        ends.append(np.sum(y[:, np.r_[:4, -4:0]] ** 2) / (8 * made.freedom))

    # 56 degrees of freedom: chance makes 0.2; ends that counted had 6
    assert np.mean(ends) < 1.5


@pytest.mark.parametrize("case", [Case("lever", "rich", 4), Case("crane", "rich", 6)], ids=lambda c: c.name)
def test_each_balances_noise_is_predicted(case: Case) -> None:
    """Whose leftover is noise, and whose is not, is told by this number."""
    balances, made = whitened(case.robot, healthy(case))

    residual = balances.time_series(balances.residual(()))[:, balances.motion.readings.valid]

    # the sensors' own noise is predicted within 10 %; chance makes 2 %
    assert np.std(residual, axis=1) == pytest.approx(made.deviation, rel=0.1)


def test_a_cause_raises_the_energy_of_its_balance_only() -> None:
    recorded = Case("lever", "rich", 4).with_causes(Planted("torque_sensor_gain", "swing", {"gain": 0.05}))

    # rows: motor, link, spring; the Cholesky factor lets earlier balances leave later ones alone
    motor, link, spring = energy("lever", recorded)[1]

    assert motor == pytest.approx(1.0, abs=0.15)
    assert link == pytest.approx(1.0, abs=0.15)
    assert spring > 10.0


def test_an_effect_at_work_takes_its_own_trace_out_of_the_balances() -> None:
    recorded = Case("lever", "rich", 4).with_causes(
        Planted("motor_viscous_friction", "swing", {"coefficient": 4.0})
    )
    balances = Balances(motion_of("lever", recorded))
    effect = Planned(catalogue()["motor_viscous_friction"], "swing", {"coefficient": 4.0})
    valid = balances.motion.readings.valid

    before, after = (balances.time_series(balances.residual(e))[:, valid] for e in ((), (effect,)))

    row = next(r for r, x in enumerate(balances.rows) if x.balance == "motor")
    others = [r for r in range(len(balances.rows)) if r != row]
    # what is left is encoder noise in B theta'': a small part of 4 N m s/rad at about 1 rad/s
    assert np.std(after[row]) < 0.1 * np.std(before[row])
    assert np.array_equal(before[others], after[others])
    change = balances.time_series(balances.change((), (effect,)))[:, valid]
    assert change == pytest.approx(after - before, abs=1e-9)


# --------------------------------------------------------------------------- nominal numbers
@pytest.mark.parametrize("name", ["lever", "crane", "gimbal"])
def test_inertial_directions_are_derivatives_by_mass_centre_and_inertia(name: str) -> None:
    tolerance, share = 0.02, 0.1
    for inertia in nominal(name).model.inertias[1:]:
        m, c, central = inertia.mass, np.array(inertia.lever), np.array(inertia.inertia)

        def dynamic(dm: float, dc: np.ndarray, di: np.ndarray, m=m, c=c, central=central) -> np.ndarray:
            return pin.Inertia(m + dm, c + dc, central + di).toDynamicParameters()

        steps = [(tolerance * m, np.zeros(3), np.zeros((3, 3)))]
        for k in range(3):
            step = tolerance * (abs(c[k]) + share * np.linalg.norm(c))
            steps.append((0.0, step * np.eye(3)[k], np.zeros((3, 3))))
        for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):  # pin's order
            size = abs(central[i, j]) + (share * np.trace(central) if i != j else 0.0)
            unit = np.zeros((3, 3))
            unit[i, j] = unit[j, i] = tolerance * size
            steps.append((0.0, np.zeros(3), unit))
        h = 1e-3  # of a step; the parameters are at most quadratic, so central differences are exact
        expected = [
            (dynamic(h * dm, h * dc, h * di) - dynamic(-h * dm, -h * dc, -h * di)) / (2 * h)
            for dm, dc, di in steps
        ]

        got = inertial_directions(inertia.toDynamicParameters(), tolerance, share)

        assert np.array(got) == pytest.approx(np.array(expected), abs=1e-9)


# --------------------------------------------------------------------------- the result
@cache
def of_backlash() -> Diagnosis:
    return found_in(Case("lever", "rich", 31), GAP)


def test_the_held_out_error_falls_to_the_noise_floor() -> None:
    case, result = Case("lever", "rich", 31), of_backlash()
    gain, intact = result.comparison, found_in(case).comparison

    assert gain is not None and gain.held_out and gain.horizon == 0.5
    assert intact is not None
    for channel, sensor in gain.noise_floor["rms"].items():
        before, after = gain.before["rms"][channel], gain.after["rms"][channel]
        # open loop, noise in a start state grows over half a second: no better than the intact machine
        assert after < 1.3 * intact.before["rms"][channel], (channel, gain)
        assert after > 0.9 * sensor, (channel, gain)
        assert before > 10 * after, (channel, gain)
        # which is what is told of the noise
        left = gain.after["rms"][channel] / gain.noise_floor["simulated"][channel]
        assert 0.6 < left < 1.5, (channel, gain)
    # what noise in the start state does to positions dies out in the spring
    assert gain.after["rms"]["tau_t.swing"] < 1.2 * gain.noise_floor["rms"]["tau_t.swing"], gain
    assert result.findings[0].gain > 0.99, summary(result)


def test_the_json_form_has_the_documented_fields() -> None:
    written = json.loads(json.dumps(to_json(of_backlash(), "extended.yaml")))
    section = DOCS.read_text().split("## Diagnosis\n")[1]
    documented = json.loads(re.search(r"```json\n(.*?)```", section, re.S).group(1))  # type: ignore[union-attr]

    assert list(written) == list(documented)
    assert written["schema"] == 1
    assert written["model"] == "extended.yaml"
    assert set(written["findings"][0]) == set(documented["findings"][0])
    assert set(written["findings"][0]["parameters"]["gap"]) == {"value", "std", "unit"}
    assert written["findings"][0]["parameters"]["gap"]["unit"] == "rad"
    for entries in ("unexplained", "not_excited", "within_tolerance"):
        for entry in written[entries]:
            assert set(entry) == set(documented[entries][0])
    assert set(written["comparison"]) == set(documented["comparison"])
    for side in ("before", "after"):
        assert set(written["comparison"][side]) == {"rms", "nrmse"}
    assert set(written["comparison"]["noise_floor"]) == {"rms", "simulated"}


def test_the_extended_model_is_written_and_read(tmp_path: Path) -> None:
    extended = of_backlash().extend(nominal("lever"))
    path = tmp_path / "extended.yaml"

    robot.write(extended, path)
    again = robot.load(path)

    fitted = of_backlash().findings[0].parameters["gap"]
    (effect,) = again.effects
    assert (effect.effect.name, effect.joint, effect.since) == ("backlash", "swing", None)
    assert effect.p.gap == pytest.approx(fitted.value, rel=1e-9)  # type: ignore[union-attr]


def test_with_the_cause_in_the_model_the_machine_is_healthy() -> None:
    case = Case("lever", "rich", 31)
    extended = of_backlash().extend(nominal("lever"))

    result = diagnose(extended, [as_recording(case.with_causes(GAP))])

    assert result.verdict == "healthy", summary(result)


# --------------------------------------------------------------------------- what is refused
def test_a_robot_at_rest_is_refused() -> None:
    result = found_in(Case("lever", "rest", 1))

    assert result.verdict == "refused"
    assert "moves" in result.reason
    assert not result.findings


def test_a_second_of_data_is_refused() -> None:
    recording = as_recording(healthy(Case("lever", "rich", 4))).between(3.0, 3.9)

    result = diagnose(nominal("lever"), [recording])

    assert result.verdict == "refused"
    assert "usable data" in result.reason


def test_unusable_input_is_an_error_that_says_so() -> None:
    lever = nominal("lever")
    torques = plant(
        ROBOTS / "lever.yaml",
        [],
        "rich",
        2.0,
        1,
        SensorSet(channels=("tau_t", "tau_m"), noisy_feedback=False),
    )

    with pytest.raises(RecordingError, match="at least one"):
        diagnose(lever, [])
    with pytest.raises(UnknownNameError, match="backlash"):
        diagnose(lever, [as_recording(healthy(Case("lever", "rich", 4)))], excluded=frozenset({"backlsh"}))
    with pytest.raises(RecordingError, match=r"q\.<joint> or theta\.<joint>"):
        diagnose(lever, [as_recording(torques)])


def test_progress_rises_from_nothing_to_all() -> None:
    seen: list[float] = []
    recording = as_recording(healthy(Case("lever", "rich", 4)))

    diagnose(nominal("lever"), [recording], progress=lambda share, _what: seen.append(share))

    assert seen[0] == 0.0 and seen[-1] == 1.0
    assert seen == sorted(seen)
