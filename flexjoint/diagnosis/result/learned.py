"""Learned laws in words: what each is, what it removes, which laws of the catalogue it resembles, and what
that suggests to look at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flexjoint.core.text import EMPTY, Block, Line
from flexjoint.diagnosis.result import merit
from flexjoint.diagnosis.result.values import Learned, LearnedLaw, Likeness
from flexjoint.diagnosis.result.wording import (
    Joints,
    capital,
    clean,
    effect_name,
    less,
    listed,
    number,
    percent,
    sentence,
)
from flexjoint.diagnosis.settings import USUAL

NAMED = 3  # effects that are named on each side
TITLE = "Laws without a name"
NO_CAUSE = "Smooth laws of one or two signals through what no cause explains. They are no causes."
NOTHING = "No law of one or two signals removes enough of what is left on data that it did not see."
PLACES = {
    "learned_surface": "a torque on the motor",
    "learned_torque": "a torque on the motor",
    "learned_link_torque": "a torque on the link",
    "learned_deflection": "a deflection",
}


def name_of(law: LearnedLaw, joints: Joints) -> str:
    """What it is: a torque on the motor of elbow, of its speed."""
    place = PLACES[law.effect]
    if joints.rigid and place == PLACES["learned_torque"]:
        place = "a torque"
    both = f" and {joints.signal(law.other)}" if law.other else ""
    return f"{place} at {clean(law.joint)} that follows {joints.signal(law.signal)}{both}"


def removed_line(law: LearnedLaw, joints: Joints) -> str:
    """What it removes on data that its fit did not see, and with how much freedom."""
    fall = joints.fall(law.joint, law.removed.without, law.removed.left)
    part = less(law.removed.without, law.removed.left)
    return sentence(
        f"{capital(name_of(law, joints))}: error of the {clean(law.removed.balance)} balance {fall} ({part}),"
        f" {percent(law.share)} of its square, with {number(law.freedom, 2)} degrees of freedom"
    )


def likeness_lines(law: LearnedLaw) -> tuple[str, ...]:
    """Which laws of the catalogue it resembles, and which it does not."""
    limits = USUAL.learn
    close = [one for one in law.alike if one.correlation >= limits.alike]
    far = [one for one in law.alike if one.correlation < limits.unlike]
    if close:
        first = f"It resembles {_several(close)}; yet none of them was found to explain it"
    elif law.alike:
        first = f"It resembles no law of the catalogue; {_several(law.alike[:1])} comes closest"
    else:
        return ()
    return (sentence(first), *([sentence(f"It does not resemble {_several(far)}")] if far else []))


def _several(likenesses: Sequence[Likeness]) -> str:
    return listed(f"{effect_name(one.effect)} ({one.correlation:.2f})" for one in likenesses[:NAMED])


def advice_line(law: LearnedLaw) -> str:
    return sentence(capital(clean(law.advice)))


def simulation_line(learned: Learned) -> str:
    """How far the simulation is from the recording without the laws and with them; empty where unknown."""
    whole = merit.overall(learned.simulation)
    if whole is None:
        return ""
    return sentence(
        f"On data that no law saw, the simulation's error (NRMSE) is {number(whole.before)} with the likely"
        f" causes, and {number(whole.after)} with the laws, too"
    )


def blocks(learned: Learned, joints: Joints) -> Iterator[Block]:
    """The section of the terminal and of a notebook."""
    yield EMPTY
    yield Line(TITLE, "bold")
    yield Line(NO_CAUSE if learned.laws else NOTHING)
    for law in learned.laws:
        yield Line(removed_line(law, joints))
        for line in likeness_lines(law):
            yield Line(f"  {line}")
        yield Line(f"  {advice_line(law)}")
    if line := simulation_line(learned):
        yield Line(line)
    for note in learned.notes:
        yield Line(sentence(capital(clean(note))), "dim")
