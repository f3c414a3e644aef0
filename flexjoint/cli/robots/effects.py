"""`flexjoint effects`: the catalogue of effects as a list, and as the page docs/reference/effects.md."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Iterator

from flexjoint.effects import Effect, Parameter, Site, catalogue

SITES = {
    Site.COMMAND: "On the command, between controller and motor.",
    Site.MOTOR: "On the motor.",
    Site.DEFLECTION: "In the transmission, on the deflection phi = theta - q.",
    Site.SPRING: "In the transmission, on its torque tau_t.",
    Site.LINK: "On the link.",
    Site.BODY: "On the rigid body itself.",
    Site.SENSOR: "On what the sensors say.",
}
HEAD = """\
# Effects

Generated from the catalogue by `flexjoint effects --markdown`; do not edit. One file per effect under
`flexjoint/effects/`; [adding_an_effect.md](../howto/adding_an_effect.md) tells how to write one. Symbols
and signs: [conventions.md](../explained/conventions.md). An effect is absent where its parameters have their
null values; a shape has none, and means nothing while the amplitude beside it is null.
"""


def run(arguments: argparse.Namespace) -> None:
    """The command."""
    if arguments.markdown:
        print(markdown(), end="")
    else:
        show()


def show() -> None:
    """Print the catalogue: names by site, parameters with units, what each effect is."""
    for site, effects in _by_site():
        print(SITES[site])
        for effect in effects:
            print(f"  {effect.name}({', '.join(_arguments(effect))})")
            print(textwrap.fill(summary(effect), 100, initial_indent="      ", subsequent_indent="      "))


def markdown() -> str:
    """The page docs/reference/effects.md."""
    parts = [HEAD]
    for site, effects in _by_site():
        parts.append(f"\n## {SITES[site].rstrip('.')}\n")
        for effect in effects:
            parts.append(_entry(effect))
    return "".join(parts)


def summary(effect: Effect) -> str:
    """What an effect is, in its own words."""
    return " ".join((type(effect).__doc__ or "").split())


def typical_sizes(effect: Effect) -> str:
    """Its sizes on real machines and parts, each with a link to who states it; empty where none is known."""
    stated = (f"{one.size} ([{one.source.name}]({one.source.address}))" for one in effect.typical)
    return f"Typical sizes: {'; '.join(stated)}." if effect.typical else ""


def _by_site() -> Iterator[tuple[Site, list[Effect]]]:
    for site in SITES:
        effects = [effect for effect in catalogue().values() if effect.site is site]
        if effects:
            yield site, effects


def _arguments(effect: Effect) -> Iterator[str]:
    for param in effect.params:
        yield f"{param.name} [{param.unit}]" if param.unit else param.name
    for word in effect.words:
        yield word.name


def _entry(effect: Effect) -> str:
    lines = [f"\n### {effect.name}\n", f"{summary(effect)}\n"]
    lines.append(f"\n$${effect.law}$$\n")
    lines.append("\n| parameter | symbol | unit | default | range | null |\n|---|---|---|---|---|---|\n")
    lines.extend(_row(param) for param in effect.params)
    for word in effect.words:
        choices = ", ".join("all" if choice is None else choice for choice in word.choices)
        lines.append(f"| {word.name} | | word | {word.value or 'all'} | {choices} | |\n")
    lines.append(f"\nReported as {effect.kind.value}; its residual is plotted against {effect.against}.")
    if effect.contains:
        lines.append(f" Contains {', '.join(effect.contains)} as a special case.")
    lines.append(f" Reference: {effect.reference}.\n")
    if effect.typical:
        lines.append(f"\n{typical_sizes(effect)}\n")
    return "".join(lines)


def _row(param: Parameter) -> str:
    null = "shape" if param.null is None else _number(param.null)
    unit = param.unit or "1"
    size = f" ({param.size} numbers)" if param.size > 1 else ""
    bounds = f"{_number(param.low)} to {_number(param.high)}"
    return (
        f"| {param.name}{size} | ${param.symbol}$ | {unit} | {_number(param.value)} | {bounds} | {null} |\n"
    )


def _number(value: float) -> str:
    return "unbounded" if math.isinf(value) else f"{value:g}"
