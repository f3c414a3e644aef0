"""Every number that decides in a diagnosis and what follows it, with its unit, its reason and its evidence.

One frozen class a stage, all of them in `Settings`; `diagnose(..., settings=...)` takes another set:

    replace(Settings(), search=replace(SearchSettings(), price=20.0))

The readings carry the settings, and with them every stage that follows. Numbers that only serve numerics or
memory (paddings, cache sizes, chunk lengths) stay where they are used. `make docs` writes
docs/reference/settings.md.

Evidence is one of: theory (it follows from a statement that is named), study (planted machines, `make study`,
docs/studies/diagnosis_study.md), machine (a real recording), judgement (chosen, and not varied by itself).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields
from typing import Any

from flexjoint.core.errors import ModelError


def number(value: Any, unit: str, reason: str, evidence: str) -> Any:
    """A field of a settings class: its value, unit, what it is for, and what it rests on."""
    return field(default=value, metadata={"unit": unit, "reason": reason, "evidence": evidence})


class Stage:
    """The numbers of one stage of a diagnosis.

    Raises ModelError for a value that is no number, or not of the kind of the default one."""

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            flat, default = _flat(value), _flat(one.default)
            usual = len(flat) == len(default) or isinstance(one.default, tuple)
            whole = isinstance(one.default, int)
            if not usual or not all(_usable(v, whole) for v in flat):
                kind = "a whole number" if whole else "finite numbers, none below zero,"
                raise ModelError(
                    f"{type(self).__name__}.{one.name}: expected {kind} like {one.default!r}"
                    f" ({one.metadata['unit'] or 'no unit'}), got {value!r}"
                )


def _flat(value: Any) -> list[Any]:
    if not isinstance(value, tuple):
        return [value]
    return [number for part in value for number in _flat(part)]


def _usable(value: Any, whole: bool) -> bool:
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        return False
    return math.isfinite(value) and value >= 0


@dataclass(frozen=True)
class DataSettings(Stage):
    """Data: whether signs, zeros, units and names are right, asked before any cause is blamed."""

    instants: int = number(
        300, "instants", "at which torques are compared: enough for any motion of some seconds", "judgement"
    )
    smoothing: float = number(
        0.02, "s", "least standard deviation of the kernel that gives accelerations", "judgement"
    )
    gain_range: tuple[float, ...] = number(
        (0.5, 2.0),
        "gain of the measured torque",
        "that is no error of the data: payloads, torque constants and inertias off by as much",
        "judgement",
    )
    rival_gains: tuple[float, ...] = number(
        (0.3, 3.0), "gain of the measured torque", "that a cause may have before data are blamed", "judgement"
    )
    wrong: float = number(
        0.3,
        "share of the torque (RMS)",
        "that friction, load and inertia must leave unexplained before data are doubted",
        "machine: most joints of KR300, TX40 and EMPS leave 0.06 to 0.27",
    )
    right: float = number(
        0.25, "share of the torque (RMS)", "that may be left once the data are repaired", "judgement"
    )
    times_smaller: float = number(
        4.0,
        "factor (RMS)",
        "by which a repair must shrink the torque balance of a joint: 16 times the variance",
        "judgement",
    )
    times_rival: float = number(
        2.0,
        "factor (RMS)",
        "by which it must be smaller than with any load, offset or spring instead",
        "judgement",
    )
    alike: float = number(
        1.3, "factor (RMS)", "within which two repairs are as good, and both are said", "judgement"
    )
    least_scale: float = number(
        4.0, "factor", "from which a torque is in another unit and not just off", "judgement"
    )
    known_scale: float = number(
        1.4, "factor", "within which a factor is a known one: gear ratio, torque constant, 1000", "judgement"
    )
    unknown_scale: float = number(
        10.0, "factor", "from which one without a known reason is another unit", "judgement"
    )
    least_zero: float = number(
        0.35, "rad", "least error of a position's zero that is one of the data: 20 degrees", "judgement"
    )
    round_zero: float = number(
        0.07, "rad", "within which a zero is off by a whole eighth of a turn: 4 degrees", "judgement"
    )
    payload_mass: float = number(
        1.0, "mass of the robot", "largest load that may stand behind a torque instead", "judgement"
    )
    sides_alike: float = number(
        0.97, "correlation", "from which two encoders show the same motion", "judgement"
    )
    slope_one: float = number(
        1.5, "factor", "within which one encoder moves as far as the other", "judgement"
    )
    slope_gear: float = number(
        1.05, "factor", "within which a slope is the gear ratio: encoders are exact", "judgement"
    )
    slope_unit: float = number(
        1.03, "factor", "within which a slope is that of a unit: a spring makes it inexact", "judgement"
    )
    unit_joints: int = number(
        2, "torques", "in one unit, from which all of the channel are in it", "judgement"
    )
    round_cost: float = number(
        1.5,
        "times the variance left",
        "up to which a zero at a whole eighth of a turn is as good",
        "judgement",
    )
    changed: float = number(
        0.05, "share of a torque's variance", "from which a repair has changed it", "judgement"
    )
    deflected: float = number(
        0.5, "rad", "by which a motor's travel must exceed its link's to be no deflection", "judgement"
    )
    late_rows: float = number(
        0.05,
        "share of the rows",
        "off an even clock by more than jitter, up to which stamps are a logger's hiccups, not of arrival",
        "judgement",
    )
    rates_alike: float = number(
        0.9, "correlation", "from which a velocity and a position show the same motion", "judgement"
    )
    gyration: float = number(
        10.0, "reach of the robot", "largest radius of gyration that a body may have", "judgement"
    )
    lag_joints: int = number(
        2,
        "joints",
        "that must show a lag of the torque's reading: friction of a single one may look like it",
        "judgement",
    )
    lag_sure: float = number(
        5.0,
        "standard errors",
        "that such a lag must have at a joint, to show it or to contradict it",
        "machine: joints of KR300, TX40 and EMPS reach 3.2 in six recordings, but one of KR300's C 10",
    )
    lag_least: float = number(
        1e-3, "s", "least lag of torques: below it any two readings of one row may differ", "judgement"
    )
    lag_alike: float = number(
        0.3, "share of the lag", "by which it may differ at a joint: a filter is that of all", "judgement"
    )
    lag_agreeing: float = number(
        0.75, "share of joints", "of those that can tell, that must agree with the lag", "judgement"
    )
    lag_moving: float = number(
        0.2,
        "joint's speed (RMS)",
        "below which a lag is not looked for: friction reverses there",
        "judgement",
    )


@dataclass(frozen=True)
class SignalSettings(Stage):
    """Readings: one clock, one filter, predicted noise."""

    filter_seconds: float = number(
        0.004, "s", "least standard deviation of the Gaussian filter that serves every signal", "judgement"
    )
    edge_deviations: float = number(
        8.0, "filter deviations", "samples this close to an end or a gap are not used", "judgement"
    )
    edge_seconds: float = number(
        0.15,
        "s",
        "samples this close to an end or a long gap are not used: whitening integrates what differentiation"
        " has made large, and noise that is cut off leaves a tail of half a second",
        "judgement",
    )
    tick_slack: float = number(
        0.2, "control periods", "by which a stamp may precede the tick of its command", "judgement"
    )
    longest_bridge: int = number(
        4, "samples", "missing samples in a row that are interpolated and used", "judgement"
    )
    sure_jump: float = number(
        5.0, "standard deviations", "of a torque's noise, above which a jump is none of it", "judgement"
    )
    jump_noise: float = number(
        30.0,
        "standard deviations of the noise, or steps",
        "of a position's jump between two samples, at least",
        "judgement: far beyond chance in an hour at 1 kHz; less is told by what it does to torques",
    )
    jump_smooth: float = number(
        0.1,
        "times the jump",
        "that samples beside it may be off a parabola once it is taken out: a body that is hit moves on"
        " otherwise",
        "judgement",
    )
    sensor_levels: float = number(
        10.0, "steps", "range of a torque, from which its steps are those of a sensor", "judgement"
    )
    dithered: float = number(
        0.5,
        "encoder steps",
        "other noise, beyond which what rounding leaves is white",
        "theory: Bennett 1948; Widrow and Kollar 2008",
    )
    least_colour: float = number(
        0.3,
        "share of the white spectrum",
        "least spectrum of rounding that is believed: what noise there is besides is known no better",
        "judgement",
    )


@dataclass(frozen=True)
class BalanceSettings(Stage):
    """Balances: what must vanish, and dry friction at rest."""

    shortest: float = number(1.0, "s", "usable data below which no verdict is given", "judgement")
    still: float = number(
        20.0,
        "noise deviations",
        "travel that a joint must have to show anything that depends on its angle",
        "judgement",
    )
    rest_speed: float = number(0.04, "rad/s", "above it a body moves whatever its friction", "judgement")
    least_rest_speed: float = number(
        0.003,
        "rad/s",
        "below it a real joint creeps, and the sign of its speed does not tell its friction; raised by the"
        " robust search",
        "machine: KR300, of whose joint 3 267 N m are left with none, 70 N m with this one, 66 N m at 0.02",
    )
    drawn: float = number(
        0.2,
        "of critical damping",
        "with which the link of a joint that bends is drawn to where the torque that its motor passes on puts"
        " it",
        "study: the right spring of a planted lever leaves 3, 10 and 41 % more than its noise at 0.1, 0.3 and"
        " 1.0; the smaller the ratio, the nearer to the right number a fit must begin",
    )
    drawn_band: float = number(
        3.0,
        "resonances",
        "up to which the motor's torque draws the link",
        "theory: above its resonance a link stays where it is, and a torque tells its own noise",
    )
    rest_rings: float = number(
        1.0,
        "filter deviations",
        "around which the speed is known no better than the filter has changed it, by the kinks of the"
        " friction itself; as many times the change that a filter's width makes, to begin with",
        "study: dry frictions of 18 drawn machines leave 1.24 times the noise (geometric mean), 1.49 times"
        " where one such speed holds for all of a recording",
    )
    play_deviations: float = number(
        0.5,
        "deviations of a denoised position",
        "by which it may go to and fro without any way for a state of friction, creep or hysteresis",
        "study: of 19 drawn machines with such a state, what the right law leaves fell at six (2.35 to 0.96"
        " of the noise, 1.70 to 0.52, 6.6 to 4.1, ...), and rose at one (1.00 to 1.06); with 2 at six",
    )
    speed_deviations: float = number(
        4.0,
        "standard deviations",
        "of a speed's noise, below which its sign says nothing",
        "theory: normal tail",
    )
    most_at_rest: float = number(
        1.25,
        "friction levels",
        "what a friction holds at most: what the filter leaves of a breakaway may overshoot the level",
        "judgement",
    )
    noisy_friction: float = number(
        0.1,
        "friction levels",
        "noise of the torque at rest from which the denoised recording says what pulls: it would be"
        " cut off on"
        " one side where all of the friction holds",
        "judgement",
    )
    ringing: float = number(
        5.0,
        "filter deviations",
        "within which of a motion a denoised acceleration rings",
        "theory: tail of a Gaussian",
    )


@dataclass(frozen=True)
class RegressionSettings(Stage):
    """Regression: predicted noise, tolerances, and the noise inflation that an incomplete model needs."""

    plausible: float = number(
        2.5,
        "prior deviations",
        "up to which a nominal number may be off before a cause must be sought, and beyond which an energy is"
        " evaluated in full and not to first order",
        "theory: one number in eighty of a machine as the robot file claims it is further off",
    )
    implausible: float = number(
        6.0, "prior deviations", "from which a nominal number is that of another machine", "judgement"
    )
    telling: float = number(
        100.0,
        "energy (chi-square)",
        "that must remain for a cause to be able to gain its price: noise is not inflated below twice that",
        "judgement",
    )
    telling_share: float = number(
        0.1,
        "share of the information about a nominal number",
        "of the balance that has most of it, from which a balance is raised where the number is implausible",
        "study: of a drive's numbers other joints' balances have less than 2 %, through their noise only",
    )
    noise_decides: float = number(
        3.0,
        "noise inflation",
        "up to which sensor noise decides: a balance that leaves no more counts as explained",
        "judgement",
    )
    fewest_samples: int = number(
        100, "samples", "independent ones that a recording is credited with at least", "judgement"
    )
    factor_deviation: float = number(
        0.7,
        "log",
        "weak prior of a factor on a nominal number: a factor of two is one deviation",
        "theory: ln 2",
    )
    position_deviation: float = number(
        0.5, "m", "weak prior of components of a position that the data do not show", "judgement"
    )
    angle_deviation: float = number(
        1.0,
        "rad",
        "weak prior of a position of a joint, about zero: a spring at rest far away is only an offset",
        "judgement",
    )
    torque_deviation: float = number(
        1.0,
        "joint's RMS torque",
        "weak prior of the level of a friction or a ripple: hardly larger than all torque of its joint",
        "machine: KR300, where a breakaway friction that few samples show ended at its bound without it",
    )
    offset_deviation: float = number(
        0.2, "rad", "prior of an encoder offset that is free in each recording", "judgement"
    )
    other_component: float = number(
        0.1,
        "share",
        "of the length of a centre of mass (trace of an inertia) to which its small components are trusted",
        "judgement",
    )
    least_jump: float = number(
        0.5, "noise deviations", "from which a torque's jump between two samples matters", "judgement"
    )
    least_command: float = number(
        0.01, "share", "of a command that a motor without torque still has", "judgement"
    )
    band_gain: float = number(
        0.25, "filter gain", "where the band ends in which residuals are whitened", "judgement"
    )
    missing: float = number(
        0.1,
        "noise variances",
        "that a white sample may lack of what was cut off at ends and gaps",
        "judgement",
    )
    least_steady: float = number(
        0.5,
        "share of the samples",
        "that must be left by that: else the record is used as it is",
        "judgement",
    )
    fed_back: float = number(
        1.2,
        "noise deviations",
        "of a torque, up to which that may be what a controller made of the motor's angle",
        "judgement",
    )
    most_fed_back: float = number(
        0.95, "share", "of a torque's noise that is believed to be fed back at most", "judgement"
    )
    numerical_floor: float = number(
        6e-4,
        "share of the RMS torque",
        "error of filters and interpolation in a balance, white in the band",
        "judgement",
    )
    time_block: float = number(
        1.0,
        "s",
        "of the blocks behind standard errors and comparisons of rivals: residuals are correlated"
        " within them",
        "theory: White 1980; Newey and West 1987; Vuong 1989",
    )


@dataclass(frozen=True)
class SearchSettings(Stage):
    """Search: the price of a cause, what else it must pass, and which candidates are tried."""

    # --- the time allowed (`Budget`)
    time: float = number(0.7, "share of the time allowed", "after which a search ends", "judgement")
    trying_time: float = number(
        0.8,
        "share of a search's time",
        "after which no further set is tried: the rest is for judging those that were",
        "judgement",
    )
    looking_time: float = number(
        0.9,
        "share of the time allowed",
        "after which nothing else is looked for: what was found is then judged, which is not cut",
        "judgement",
    )
    # --- prices
    price: float = number(
        16.0,
        "energy (chi-square)",
        "of an effect of one number: some hundred candidates are tried, and one healthy recording in"
        " a hundred"
        " may name one by chance",
        "theory: four standard deviations",
    )
    price_nominal: float = number(
        11.0,
        "energy (chi-square)",
        "of a nominal number beyond its tolerance: of robots whose four numbers a joint scatter as"
        " claimed, one"
        " in 250 has such a one",
        "theory: 3.3 standard deviations",
    )
    price_number: float = number(
        12.0,
        "energy (chi-square)",
        "of every further number that has a trace, and of an onset: more than chance gives, less than a law",
        "judgement",
    )
    one_value: float = number(
        0.4,
        "share of its size on one joint",
        "by which a cause that several joints often have in common may differ on another and count as the"
        " same one, which costs no more than a further number",
        "judgement",
    )
    price_reconstructed: float = number(
        24.0,
        "energy (chi-square)",
        "more for every effect where a position is made of the nominal model, which is known to first order",
        "judgement",
    )
    price_candidates: float = number(
        2.0,
        "energy per log of joints",
        "of so many more candidates chance favours one by so much more",
        "theory: extreme values of chi-square",
    )
    unexplained_share: float = number(
        0.05,
        "share of the unexplained energy",
        "that a cause, or a finer law, must explain at least (ordinary friction: of its own balances), and by"
        " which ties may differ",
        "judgement",
    )
    common_joints: int = number(
        3,
        "joints",
        "with ordinary friction, if they are most, from which on it is the machine's: no other law takes its"
        " place there, but may act beside it",
        "judgement: a real arm has it on all",
    )
    ordinary_share: float = number(
        0.5,
        "share of a joint's error (RMS)",
        "that its ordinary friction may leave where it is taken as the first thing that several joints lack",
        "judgement",
    )
    # --- the method's own error
    method_error: float = number(
        1e-3,
        "share",
        "of what a joint's other causes explain, which filters and friction at rest may leave",
        "judgement",
    )
    finer_method_error: float = number(
        1e-4,
        "share",
        "the same where a cause leaves less than a tenth of what it explains, and every position was"
        " measured",
        "judgement",
    )
    least_method_error: float = number(
        1e-5, "share", "the same where a large cause leaves nothing but noise", "judgement"
    )
    perfect: float = number(
        1000.0, "times the energy left", "that a cause must explain for the least error", "judgement"
    )
    filtered: float = number(
        1e-5,
        "share of the explained energy",
        "by which laws differ as filtered balances see their kinks: the simpler one is taken",
        "judgement",
    )
    filtered_reconstructed: float = number(
        1e-4, "share of the explained energy", "the same where a position is made of the model", "judgement"
    )
    # --- what is wrong, and what clears it
    wrong: float = number(10.0, "noise inflation", "from which a balance is wrong", "judgement")
    cleared: float = number(
        10.0,
        "factor in variance",
        "by which a set must leave less, to be judged at the noise level that it leaves, and by"
        " which no balance"
        " may grow",
        "judgement",
    )
    # --- sizes that count
    negligible: float = number(
        0.1, "torque tolerances", "below which no effect is named whatever it explains", "judgement"
    )
    certain: float = number(
        100.0,
        "energy (chi-square)",
        "that an effect below the torque tolerance must explain",
        "theory: ten standard deviations",
    )
    certain_dated: float = number(
        1000.0,
        "energy (chi-square)",
        "the same with an onset: over a whole recording one fits something small by chance",
        "judgement",
    )
    beyond_noise: float = number(
        1000.0,
        "energy (chi-square)",
        "from which an effect need not be confirmed on the denoised recording",
        "judgement",
    )
    denoised_share: float = number(
        0.5,
        "share",
        "of a smaller energy that a law must explain on the denoised recording, too",
        "judgement",
    )
    moved_noise: float = number(
        4.0,
        "sizes of the moved noise",
        "that a delay or a lag must explain: chance gives 2, and the search takes the best of many",
        "theory: moving noise n against noise m changes an energy by 2 m dn",
    )
    sliding: float = number(
        9.0,
        "energy (chi-square)",
        "that a dry friction must explain while its body slides: at rest it takes up the noise of what pulls",
        "theory: three standard deviations",
    )
    between_samples: float = number(
        0.5,
        "times between samples without a recorded command",
        "below which a shift of a command is none beside another cause of timing",
        "theory: when a command changed in between is known no better",
    )
    at_bound: float = number(
        0.1, "relative distance", "from a bound, within which a number counts as at it", "judgement"
    )
    boundless: float = number(
        30.0,
        "RMS torques",
        "of a joint, or of what a law shows, beyond which a named torque is none",
        "judgement",
    )
    tolerated: float = number(
        2.0, "prior deviations", "up to which a nominal number that is off is no cause", "judgement"
    )
    further: float = number(
        2.0,
        "times another set's deviation",
        "up to which a set may need nominal numbers to be off",
        "judgement",
    )
    # --- how many
    most_effects: int = number(
        12, "effects", "in a set, beside what every drive has, or the next if that is more", "judgement"
    )
    most_a_joint: int = number(3, "effects a joint", "on average, beside what every drive has", "judgement")
    most_on_joint: int = number(
        4, "effects", "on one joint, beside what every drive has: a fifth is not believed", "judgement"
    )
    most_exchanges: int = number(4, "exchanges", "so that two equals do not alternate for ever", "judgement")
    # --- which candidates are tried
    ripples: int = number(
        2, "ripples", "of a balance, the strongest, from which a periodic law is looked for", "judgement"
    )
    ripple_scales: tuple[float, ...] = number(
        (0.1, 1.0),
        "s",
        "on which these are found: what a balance does on a longer one is no ripple, as a slow motion makes"
        " slow ones",
        "judgement",
    )
    later: tuple[float, ...] = number(
        (0.0, 0.5, 0.75),
        "share of the recording",
        "from where a load is looked for: one that comes late is not what the whole recording would"
        " have it be",
        "judgement",
    )
    heavy: float = number(10.0, "link masses", "weak prior of a load's mass", "judgement")
    reach: float = number(0.5, "m", "weak prior of a load's place", "judgement")
    trial_share: float = number(
        0.05, "share of the RMS torque", "size at which the trace of an effect is taken", "judgement"
    )
    most_amplitude: float = number(1.5, "times its start", "to which a scan lets an effect grow", "judgement")
    polished: int = number(8, "candidates", "that are fitted in full at each step", "judgement")
    promising: float = number(
        0.3, "share of the best gain", "that they must show to first order", "judgement"
    )
    paired: int = number(
        3,
        "pairs of causes",
        "of a joint that are fitted, those that explain most to first order, where no single cause is found",
        "judgement: of look-alikes (a lag, a delay) two are often among the best",
    )
    alternatives: int = number(
        12,
        "candidates",
        "tried in the place of an effect: where a joint is pulled one way, four are the same",
        "judgement",
    )
    alternative_share: float = number(
        0.7, "share of what the effect explains", "that they must show to first order", "judgement"
    )
    unfitted: float = number(
        0.3, "share", "of its fitted size that a scan shows of an effect at least", "judgement"
    )
    far_worse: float = number(
        3.0,
        "times the least energy",
        "from which a set is not fitted again at the noise level of another",
        "judgement",
    )
    least_period: float = number(
        0.5,
        "periods",
        "of a torque that repeats, that a motion must cover: with less it does not come back, and any"
        " smooth torque of one signal looks so",
        "machine: a spring balancer as 0.17 periods of a ripple; ripples that slow motions show, 0.56",
    )
    astray: float = number(
        3.0,
        "factor",
        "beyond the places where a law's shape was looked for, from which it ran away from them",
        "judgement",
    )
    chance: float = number(1.0, "energy (chi-square)", "that tells nothing", "theory: one degree of freedom")
    # --- onsets
    onset_blocks: int = number(16, "blocks", "of time at whose edges an onset is tried", "judgement")
    onset_seconds: float = number(
        1.0,
        "s",
        "beside an end, where no onset is looked for: what internal states had before looks so there",
        "judgement",
    )
    onset_share: float = number(
        0.1, "share of the recording", "the same where the recording is short", "judgement"
    )
    onset_margin: float = number(
        0.05, "share", "by which a trace with an onset must be better to be preferred", "judgement"
    )
    undated: float = number(
        0.01, "share of what the onset gains", "in favour of an effect that was always there", "judgement"
    )
    onset_steps: tuple[tuple[float, ...], ...] = number(
        ((0.25, 0.1, 0.04), (0.015, 0.006, 0.002)),
        "s",
        "by which an onset is dated, with a fit after each row: a jump of an encoder is seen to the sample",
        "judgement",
    )
    switch_seconds: float = number(
        0.5,
        "s",
        "that something is held at least, and at least is not, where a cause comes and goes: switched faster,"
        " it would imitate laws of the motion",
        "judgement",
    )
    switch_rounds: int = number(
        4,
        "rounds",
        "at most, in which the times at which a cause comes and goes and its numbers are found in turn",
        "judgement",
    )
    # --- several recordings
    present: float = number(
        1.0,
        "standard errors",
        "disagreement counted, by which a number common to recordings must differ from none",
        "judgement",
    )
    disagree: float = number(
        3.5,
        "standard errors",
        "by which a recording's own number may differ from the common one",
        "judgement",
    )


@dataclass(frozen=True)
class RobustSearchSettings(Stage):
    """Robust search: causes that the simulation confirms, where only implausible nominal numbers would
    explain an error."""

    begins: float = number(
        3.0,
        "noise inflation",
        "granted because nominal numbers are implausible, from which an error counts as left over",
        "judgement",
    )
    disagreeing: float = number(
        10.0,
        "noise deviations",
        "from which a link encoder and its spring disagree",
        "judgement",
    )
    most_at_rest: float = number(
        1.0,
        "friction levels",
        "what a dry friction holds at most",
        "machine: KR300; before a real joint slides it creeps",
    )
    most_inflation: float = number(
        2.0**12, "noise inflation", "of a joint's balances for implausible nominal numbers", "judgement"
    )
    tried: int = number(4, "candidates", "of a joint that are fitted and simulated", "judgement")
    promising: float = number(
        10.0, "energy (chi-square)", "that a candidate must remove to first order", "judgement"
    )
    cleared: float = number(
        2.0,
        "factor in variance",
        "by which a cause must leave less in the wrong balances of its joint",
        "machine: KR300, joint 6, 3.5 times less with a wrong cause",
    )
    lowered: float = number(
        1.5,
        "factor",
        "by which a cause must lower the error of its joint's simulation",
        "machine: KR300, joint 6, where a wrong cause raises it by 2.6",
    )
    lowered_beside: float = number(
        1.25, "factor", "the same for a joint's nominal dry friction beside another one", "judgement"
    )
    disturbed: float = number(
        1.25,
        "factor",
        "by which no other joint's error may grow: joints that are coupled hide each other's",
        "judgement",
    )


@dataclass(frozen=True)
class RefinementSettings(Stage):
    """Refinement: numbers on the simulation itself, and when they are not taken."""

    most_left: float = number(
        30.0,
        "noise deviations",
        "that a set may leave in a balance, correlated samples counted as the few independent ones they are:"
        " beyond it a simulation cannot be fitted to the noise of the readings",
        "machine: EMPS, KR300 and TX40 leave 70 to 900, and no refinement of theirs was ever taken",
    )
    window_lengths: tuple[float, ...] = number(
        (0.2, 0.1, 0.05), "s", "of the windows that are tried, the longest first", "judgement"
    )
    linearisation: float = number(
        0.07,
        "share of the recording's time",
        "of one core that one linearisation of all windows may take: some fifteen follow each other; beyond"
        " it, windows are left out",
        "machine: a simulated UR5, 24 s, whose numbers took 120 s to refine, and were not taken",
    )
    disturbed: float = number(
        1.1,
        "squared residual per degree of freedom",
        "from which the noise of the motor torques is sought in it",
        "judgement",
    )
    noise_explains: float = number(
        1.5, "squared residual per degree of freedom", "up to which noise explains it", "judgement"
    )
    shorter: float = number(
        0.7, "share of the residual", "that windows of half the length must leave to be taken", "judgement"
    )
    outlying: float = number(5.0, "times the usual residual", "from which a window is left out", "judgement")
    few_outlying: float = number(
        0.02, "share of the windows", "left out, that is no sign of windows that are too long", "judgement"
    )
    most_outlying: float = number(
        0.2, "share of the windows", "left out, beyond which a refinement has no basis", "judgement"
    )
    fewest_windows: int = number(8, "windows", "that a refinement needs", "judgement")
    follows: float = number(
        1.05,
        "squared residual per degree of freedom",
        "up to which the simulation follows the readings to their noise",
        "judgement",
    )
    worse: float = number(
        4.0,
        "times what chance takes",
        "from which windows that were not fitted speak against a refinement",
        "judgement",
    )
    less_well: float = number(
        1.2,
        "times the balances' standard errors",
        "from which the simulation knows the numbers less well",
        "study: refined numbers, docs/explained/diagnosis_method.md section 9",
    )
    confirmed: float = number(
        2.0,
        "standard errors",
        "within which the simulation confirms a number",
        "study: refined numbers, docs/explained/diagnosis_method.md section 9",
    )
    converged: float = number(0.05, "standard errors", "by which a step may still move a number", "judgement")
    small_step: float = number(
        0.5,
        "standard errors",
        "by which the last step may: at kinks steps do not die out, but become small",
        "judgement",
    )
    method_error: float = number(
        3e-4,
        "share of a number",
        "what commands between two recorded samples, interpolated, leave at kinks",
        "judgement",
    )
    flat_prior: float = number(
        1e3, "noise deviations", "by which a window's start may differ from its measured value", "judgement"
    )
    state_prior: float = number(0.3, "share of its range", "the same of an internal state", "judgement")
    torque_block: float = number(
        0.01,
        "s",
        "of the blocks by which the noise of motor torques is estimated: motors answer more slowly",
        "judgement",
    )
    visible: float = number(
        0.1,
        "energy (chi-square)",
        "by which one deviation of a nominal number must show to count",
        "judgement",
    )


@dataclass(frozen=True)
class VerdictSettings(Stage):
    """Verdict: which causes are named, how far they are believed, and what else is said."""

    # --- the verdict
    explained: float = number(
        0.9,
        "share of the error above noise",
        "below which the causes found are not the whole story",
        "judgement",
    )
    clear: float = number(
        3.0, "torque tolerances", "by which a balance must be off to count in that share", "judgement"
    )
    above_noise: float = number(1.5, "noise deviations", "below which a residual counts as none", "judgement")
    telling: float = number(
        0.5,
        "share of what is left of a joint (RMS)",
        "that a smooth law of one signal must remove to be a lead to follow",
        "judgement",
    )
    correlated: float = number(
        0.95, "correlation", "of two numbers' errors, from which it is said", "judgement"
    )
    oscillation: float = number(
        0.1,
        "share of a residual",
        "that a frequency must explain beyond any signal: a motion that repeats itself oscillates, too",
        "judgement",
    )
    # --- a push
    push_least: float = number(0.2, "s", "shortest push that is told", "judgement")
    push_most: float = number(
        0.5,
        "share of the recording",
        "longest push that is told: beyond, the rest is the exception",
        "judgement",
    )
    push_share: float = number(
        0.6,
        "share of what is left of a balance",
        "that a push must explain: half is a coincidence",
        "judgement",
    )
    push_clear: float = number(
        0.2, "the same", "by which it must explain more than any law of a signal does", "judgement"
    )
    push_quiet: float = number(
        0.5, "times the push", "that may be left (deviation) within its time and at all others", "judgement"
    )
    # --- checks
    sure: float = number(
        3.0, "standard errors", "by which a cause must differ from none", "theory: three standard deviations"
    )
    at_rest: float = number(
        1e-9,
        "rad or m",
        "of travel in all, up to which a joint never moves: an encoder repeats itself",
        "theory: rounding",
    )
    probable: float = number(
        0.1, "probability", "of a cause and its ties, below which it is not named", "judgement"
    )
    held_out_block: float = number(
        2.0, "s", "of the blocks of which every second one is held out", "judgement"
    )
    worse: float = number(
        1.2, "times the nominal error", "from which a cause makes the simulation worse", "judgement"
    )
    spoilt: float = number(
        1.5,
        "times the torque error with nominal numbers as they are",
        "which a cause may leave, as the two may cancel; with far more it is a stand-in",
        "judgement",
    )
    better_without: float = number(
        0.95,
        "share of the error",
        "of a simulation or a joint with a cause, or without it, up to which that one is better",
        "judgement",
    )
    alternatives_tried: int = number(
        3, "alternatives", "in the place of a cause that makes the simulation worse", "judgement"
    )
    # --- ties
    tie: float = number(
        12.0, "score (chi-square)", "by which an alternative may lose and still fit as well", "judgement"
    )
    tie_moved: float = number(
        12.0,
        "score (chi-square)",
        "more where readings are moved in time, which brings other noise at the ends",
        "judgement",
    )
    most_ties: int = number(3, "alternatives", "that are listed", "judgement")
    time_blocks: int = number(12, "blocks", "of time, at least, in which ties are compared", "judgement")
    throughout: float = number(
        2.0,
        "standard deviations",
        "among the blocks, from which an alternative is worse throughout",
        "theory: Vuong 1989",
    )
    # --- belief in a name
    belief: float = number(
        2.0,
        "log odds",
        "of a name that leaves no more than the noise, and without which little more is left",
        "study: 370 names on robots drawn anew, 112 of them of machines with an effect in no catalogue",
    )
    belief_left: float = number(
        2.2, "log odds", "less for every factor of ten in the variance left ...", "study: the same"
    )
    belief_removed: float = number(
        0.8,
        "log odds",
        "... and more for every factor of ten by which more is left without the cause",
        "study: the same",
    )
    belief_implausible: float = number(
        1.5, "log odds", "less where nominal numbers are implausible beside it", "study: reliability of names"
    )
    belief_crowd: float = number(
        3.0,
        "log odds",
        "less for each cause beyond `crowd` on its joint: an effect in no catalogue is more likely"
        " than three",
        "judgement: no planted machine has more than two causes",
    )
    crowd: int = number(2, "causes", "on a joint, that planted machines have at most", "study: its machines")
    jumped: float = number(
        0.98,
        "probability",
        "at least, of an encoder's offset that sets in where its reading jumps between two samples and goes"
        " on as before, however little that changes torques",
        "theory: no body moves so",
    )
    belief_held: float = number(
        9.0,
        "log odds",
        "less where unseen data hold nothing of the torque that the cause makes, and in proportion where they"
        " hold a part: at one half, where the error is as large with it as without, 0.99 becomes one half",
        "machine: right names of 12 simulated arms, KR300 and EMPS held 0.89 to 1.6, two others 0.69 and"
        " 0.76; eight wrong ones 0.39 to 0.77, but those that imitate all of a torque 0.94 to 1.1",
    )
    # --- belief in a name on a machine that always leaves something
    background_typical: float = number(
        0.03,
        "share of the joint's torque",
        "that the small errors usually make which nobody names",
        "machine: EMPS, 4 % after a fit of friction and offset; study: dirty machines",
    )
    background_even: float = number(
        2.5,
        "times a background",
        "that a cause removes which is there as likely as not",
        "study: dirty machines; below it 21 of 36 names were wrong, above three times that 5 of 35",
    )
    background_least: float = number(
        0.01,
        "share of the joint's torque",
        "that a background makes at least: where causes have taken up small errors, what is left is less",
        "study: 43 dirty machines",
    )
    background_size: float = number(
        5.0,
        "log odds",
        "more for every factor of ten beyond that, and less below",
        "study: 43 dirty machines",
    )
    background_more: float = number(
        4.0,
        "log odds",
        "less for every factor of ten by which more is left than a usual background",
        "study: 60 dirty machines, on 20 of which one large effect is in no catalogue",
    )
    background_shape: float = number(
        6.0,
        "log odds",
        "less for every factor of ten in what a smooth law of one signal would remove of that ...",
        "study: the same",
    )
    background_shaped: float = number(
        0.15, "share of what the cause removes", "... above this share", "study: the same"
    )
    simulated_factor: float = number(
        7.0,
        "factor in a simulated error",
        "on unseen data, at which a cause of the joint that the simulation needs is as likely there as not",
        "machine: KR300, deflections of joints 1 to 3 by 6 to 13; a stand-in that explains 95 % gives 4.5",
    )
    simulated_belief: float = number(
        6.0, "log odds", "more for every factor of ten beyond that, and less below", "judgement"
    )
    disbelieved: float = number(
        0.05, "probability", "of a cause up to which it is listed as not believed, and no more", "judgement"
    )
    likely: float = number(0.5, "probability", "from which a cause is taken to be there", "judgement")
    # --- whether the causes named are all
    finished: float = number(
        0.05,
        "share of the joint's torque",
        "below which what is left is background",
        "machine: EMPS, 4 % after a fit of friction and offset",
    )
    usual: float = number(
        2.0,
        "times the share of torque",
        "that is left of the other joints (their median), up to which the rest of a joint is background",
        "judgement",
    )
    usual_most: float = number(
        0.2,
        "share of the joint's torque",
        "above which what is left is no background, whatever is left of others",
        "machine: KR300 and TX40, at most 18 % after fits by hand",
    )
    unfinished_shape: float = number(
        0.15,
        "share of the variance that there was",
        "above which a shape that is left is a cause without a name",
        "judgement",
    )
    unfinished_share: float = number(
        0.5, "share of the variance that there was", "above which the main cause has no name", "judgement"
    )
    followed_belief: float = number(
        0.5,
        "probability",
        "that a name keeps with which the simulation follows the readings of one side",
        "study: 4 of 8 that left 300 times the noise, where half of the machines had an unknown effect",
    )
    # --- what else is said
    hidden: float = number(
        0.9, "share", "of what a cause explains that free nominal numbers would absorb", "judgement"
    )
    same: float = number(3.0, "standard errors", "within which joints share one value", "judgement")
    notable: float = number(
        2.0, "standard errors", "by which a nominal number must be off to be reported", "judgement"
    )
    least_off: float = number(0.25, "prior deviations", "by which it must be off, too", "judgement")
    believed: float = number(
        3.0, "prior deviations", "beyond which a nominal number stands for something else", "judgement"
    )
    detectable: float = number(20.0, "energy (chi-square)", "that makes an effect seen", "judgement")
    seen_share: float = number(
        0.2,
        "share of the RMS torque",
        "an effect that must be larger to be seen was not excited",
        "judgement",
    )


@dataclass(frozen=True)
class AgreementSettings(Stage):
    """Agreement: whether several recordings of one robot say the same."""

    chance: float = number(
        0.01,
        "probability",
        "that any number of recordings that agree counts as spread, all numbers together",
        "theory: Benjamini and Hochberg 1995",
    )
    iterations: int = number(
        8, "steps", "of a recording's own fit from the common numbers at most", "judgement"
    )


@dataclass(frozen=True)
class CheckSettings(Stage):
    """Check: whether a machine is as it was, without a search."""

    chance: float = number(
        0.01,
        "probability",
        "that any number of an unchanged machine counts as moved, all numbers of a check together",
        "theory: Benjamini and Hochberg 1995",
    )
    least_move: float = number(
        0.03,
        "share of a number",
        "by which it must move to matter: a simulation and the balances, or two motions, differ by less",
        "judgement",
    )
    freedom: float = number(
        8.0,
        "degrees of freedom",
        "that standard errors have at least: they are never below what the sensors' noise makes, however few"
        " the blocks of time behind them",
        "judgement",
    )
    unknown_error: float = number(
        1.0,
        "times the new standard error",
        "of a number whose source states none: as if a recording like the new one had told it",
        "judgement",
    )
    grown: float = number(
        2.0,
        "times what was left (RMS)",
        "that may be left: recordings of one unchanged machine differ in what they show",
        "judgement",
    )
    size: float = number(
        1.0, "torque tolerances", "that may be left wherever less was", "theory: what a tolerance means"
    )
    shape: float = number(
        0.3,
        "torque tolerances",
        "that a smooth law of one signal may remove of what is left: noise hides less in it",
        "judgement",
    )
    shape_noise: float = number(
        0.25,
        "noise deviations",
        "that such a law must remove, too: chance removes some of any noise",
        "study: planted levers; one of 33 unchanged ones alarmed without it",
    )
    level: float = number(
        10.0,
        "times the whitened variance that was left",
        "that a joint's balances may leave: noise alone gives one, and tolerances show in some motions only",
        "study: planted levers, docs/howto/checking.md",
    )
    iterations: int = number(3, "steps", "of a refit from the known values at most", "judgement")
    same_level: float = number(
        1.5, "noise inflation", "up to which a refit need not be repeated at what it leaves", "judgement"
    )
    samples_a_second: float = number(
        1500.0,
        "samples times joints a second",
        "of the recording that are looked at: a check is to take a twentieth of its length",
        "machine: KR300, 14 to 20 % on a busy core; study: planted levers and gimbals, 1 to 4 %",
    )
    samples: int = number(
        200_000, "samples times joints", "that are looked at of any recording: half a gigabyte", "judgement"
    )


@dataclass(frozen=True)
class LearnSettings(Stage):
    """Learn: smooth laws of what no cause explains."""

    outside: float = number(
        0.005,
        "share of the samples",
        "beyond either end of a law's range, where it is constant: few samples are no law",
        "judgement",
    )
    stretches: int = number(
        4,
        "stretches of time",
        "that are left out in turn, of all recordings together; of each two at least",
        "judgement",
    )
    shortest_stretch: float = number(
        1.0, "s", "of such a stretch: two windows of the simulation", "judgement"
    )
    rounds: int = number(
        3, "times", "that a law is chosen again at the noise level that it leaves", "judgement"
    )
    share: float = number(
        0.5,
        "share of the squared error, noise included",
        "that a law must remove on data that its fit did not see",
        "study: struck cases; laws that removed less changed the simulation of another motion by 1 %,"
        " either way",
    )
    sure: float = number(
        3.0,
        "standard errors",
        "by which that must differ from nothing, over pieces of time, and the law itself from none",
        "theory: three standard deviations",
    )
    size: float = number(
        1.0, "torque tolerances", "that a law must remove (RMS)", "theory: what a tolerance means"
    )
    most: int = number(2, "laws", "of one joint at most", "judgement")
    worse: float = number(
        1.01,
        "times the simulated error",
        "on unseen data, of the joint or of the robot, from which a law is dropped",
        "judgement",
    )
    sure_simulation: float = number(
        3.0,
        "standard errors",
        "by which the joint's simulated error (squared) must be less on unseen data, over blocks of time",
        "theory: three standard deviations",
    )
    part: float = number(
        0.5,
        "times the error foretold",
        "by a law over its whole range, from which it is taken over a part of it",
        "study: of struck end stops it falls to a third or less; of an unknown machine by 2 %, which another"
        " motion then paid with 20 %",
    )
    worse_place: float = number(
        1.25,
        "times the torque error",
        "with a law, at any tenth of its signal on unseen data, from which it is dropped",
        "study: a struck end stop, by whose spline another motion was 14 times worse; theory: RMS of some"
        " hundred samples scatter by a tenth",
    )
    worse_stretch: float = number(
        1.05,
        "times the torque error",
        "with a law, on any stretch that it did not see, from which it is dropped",
        "judgement",
    )
    alike: float = number(
        0.9, "correlation", "from which a law of the catalogue is one that it resembles", "judgement"
    )
    unlike: float = number(0.7, "correlation", "below which it is one that it does not resemble", "judgement")


@dataclass(frozen=True)
class PlanSettings(Stage):
    """Plan: the next experiment. What is usual serves where the robot's files say nothing."""

    seconds: float = number(16.0, "s", "of motion", "judgement")
    reach: float = number(
        0.6,
        "rad",
        "to either side of the centre: nothing is known of what stands around the robot",
        "judgement",
    )
    speed: float = number(2.0, "rad/s", "where the URDF has no limit", "judgement")
    margin: float = number(
        0.8, "share of speed and torque limits", "that a reference asks for: tracking overshoots", "judgement"
    )
    drawn: int = number(6, "motions", "that are drawn at random and tried", "judgement")
    changed: int = number(4, "motions", "that are tried after these, each a change of the best", "judgement")
    saturated: float = number(
        100.0,
        "times the energy that makes an effect seen",
        "beyond which more of it counts nothing for a motion",
        "judgement",
    )
    noise_draws: int = number(2, "draws of the sensors' noise", "of which the worst one counts", "judgement")
    most_starts: int = number(
        6, "starts", "from which a rival is fitted: those that promise most", "judgement"
    )
    sample_rate: float = number(500.0, "Hz", "at most, of the recording that is foretold", "judgement")
    usual_torque: float = number(0.25, "share of a torque limit", "that is usual in a motion", "judgement")
    usual_limit: float = number(100.0, "N m", "of a joint without a torque limit", "judgement")
    usual_speed: float = number(1.0, "rad/s", "at which an effect is to matter", "judgement")
    usual_travel: float = number(0.5, "rad", "over which it is to matter", "judgement")
    usual_delay: float = number(2e-3, "s", "that would matter", "judgement")
    encoder_noise: float = number(2e-5, "rad", "of an encoder of which nothing is known", "judgement")
    speed_noise: float = number(5e-3, "rad/s", "of a velocity of which nothing is known", "judgement")
    torque_noise: float = number(
        1e-3, "share of a torque limit", "noise of a torque sensor of which nothing is known", "judgement"
    )
    payload_torque: float = number(
        0.25, "share of a torque limit", "that a proposed payload may take at rest", "judgement"
    )
    payload_least: float = number(0.05, "kg", "of a payload that is proposed", "judgement")
    payload_arm: float = number(
        0.1, "m", "from the joint to it where the link's own centre of mass gives no place", "judgement"
    )


@dataclass(frozen=True)
class FleetSettings(Stage):
    """Fleet: who needs somebody, since when, and how sure."""

    false_alarms: float = number(
        0.05,
        "share",
        "of the robots that are shown, that nobody needs to look at",
        "theory: Benjamini and Hochberg 1995",
    )
    searches: int = number(
        3, "recordings", "that are searched in full after an alarm: the first two and the latest", "judgement"
    )
    confirmed: int = number(
        2, "recordings", "that must alarm, and name a cause alike, before its name is shown", "judgement"
    )
    fewest: int = number(5, "recordings", "in which a number can be said to have changed", "judgement")
    penalty: float = number(
        3.0,
        "log of the recordings times variance",
        "of a change point (`ruptures`, Pelt)",
        "theory: Killick, Fearnhead and Eckley 2012; Yao 1988 has two, of known variance",
    )
    warm: float = number(1.0, "deg C", "range of the temperatures from which they are taken out", "judgement")
    least_change: float = number(
        0.03, "share of a number", "by which it must change to matter, as in a check", "judgement"
    )
    alike: float = number(
        0.8,
        "share of the robots of one type",
        "with one cause, for the nominal model to be wrong",
        "judgement",
    )
    fewest_alike: int = number(3, "robots", "of one type that can be each other's reference", "judgement")
    odd: float = number(
        5.0,
        "robust standard deviations",
        "of the other robots of its type, from which one is odd",
        "judgement",
    )
    restarts: int = number(2, "times", "that a recording is tried whose worker died", "judgement")


@dataclass(frozen=True)
class Settings:
    """All numbers that decide in a diagnosis, stage by stage."""

    data: DataSettings = DataSettings()
    signals: SignalSettings = SignalSettings()
    balances: BalanceSettings = BalanceSettings()
    regression: RegressionSettings = RegressionSettings()
    search: SearchSettings = SearchSettings()
    robust_search: RobustSearchSettings = RobustSearchSettings()
    refinement: RefinementSettings = RefinementSettings()
    verdict: VerdictSettings = VerdictSettings()
    agreement: AgreementSettings = AgreementSettings()
    check: CheckSettings = CheckSettings()
    learn: LearnSettings = LearnSettings()
    plan: PlanSettings = PlanSettings()
    fleet: FleetSettings = FleetSettings()

    def stages(self) -> Iterator[tuple[str, Stage]]:
        """Every stage with its name, in the order in which they run."""
        for one in fields(self):
            yield one.name, getattr(self, one.name)


USUAL = Settings()


def settings_page() -> str:
    """docs/reference/settings.md: every number with its value, unit, reason and evidence."""
    lines = [
        "# Settings of a diagnosis",
        "",
        "<!-- written by `make docs` from flexjoint/diagnosis/settings.py; do not edit -->",
        "",
        "```python",
        "from dataclasses import replace",
        "from flexjoint.diagnosis.settings import Settings",
        "",
        "usual = Settings()",
        "stricter = replace(usual, search=replace(usual.search, price=25.0))",
        "# diagnose(robot, [recording], settings=stricter)",
        "```",
        "",
        "Every number that decides what a diagnosis says. Evidence is *theory* (it follows from what is",
        "named), *study* (planted machines, [diagnosis_study.md](../studies/diagnosis_study.md)), *machine*",
        "(a real recording) or *judgement* (chosen, and not varied by itself).",
    ]
    for name, stage in Settings().stages():
        title, _, _ = (type(stage).__doc__ or "").partition("\n\n")
        lines += ["", f"## {name}", "", " ".join(title.split()), ""]
        lines += ["| number | value | unit | what for | evidence |", "|---|---|---|---|---|"]
        lines += [_line(one) for one in fields(stage)]  # type: ignore[arg-type]
    return "\n".join(lines) + "\n"


def _line(one: Field[Any]) -> str:
    values = ", ".join(f"{v:g}" for v in _flat(one.default))
    unit, reason, evidence = (one.metadata[key] for key in ("unit", "reason", "evidence"))
    return f"| `{one.name}` | {values} | {unit} | {reason} | {evidence} |"
