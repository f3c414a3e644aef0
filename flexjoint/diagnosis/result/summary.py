"""A diagnosis in words: the verdict, the causes, what they are tied with, the errors, and what next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple

from flexjoint.core.text import EMPTY, Block, Line, Style, Table
from flexjoint.diagnosis.result import agreement, learned, merit, sentences, torque
from flexjoint.diagnosis.result.values import Finding, Result
from flexjoint.diagnosis.result.wording import (
    NOTHING,
    Joints,
    capital,
    cause,
    clean,
    deviation,
    effect_name,
    fitted,
    listed,
    number,
    percent,
    sentence,
    when,
)

CHANNELS, JOINTS = 8, 12  # rows of the two error tables; the JSON and the report hold all
HIDDEN = 3  # causes named in one sentence; of more, how many there are: the JSON and the report name them


def summary(result: Result) -> tuple[Block, ...]:
    """The summary that the terminal, `print` and a notebook show; readable without its styles."""
    return tuple(_blocks(result))


def _blocks(result: Result) -> Iterator[Block]:
    joints = Joints(result.prismatic, result.rigid)
    verdict = sentences.VERDICTS[result.verdict]
    yield Line(f"{verdict}: {clean(result.robot)}" if result.robot else verdict, "bold")
    for statement in sentences.statements(result, result.comparison, joints):
        if statement.question:
            yield from _heading(statement.question)
        if statement.question == sentences.DATA:  # columns and commands to be copied: not broken
            yield from (Line(line, whole=True) for line in statement.lines)
        else:
            yield from _lines(*statement.lines)
    if sentences.needs_reason(result):
        yield from _lines(sentence(capital(result.reason)), style="dim")
    yield from _causes("Causes", sentences.likely(result), joints)
    yield from _causes("Possible, not in the extended model", sentences.possible(result), joints)
    yield from _lines(sentences.disbelieved(result), style="dim")
    yield from _lines(*sentences.numbers(result))
    hidden = [cause(f.effect, f.joint) for f in result.findings if f.hidden_by_refit]
    if hidden:
        count = f"{len(hidden)} of these {len(result.findings)} causes"
        which = capital(listed(hidden)) if len(hidden) <= HIDDEN else count
        yield Line(f"{which} would be hidden by a refit of the nominal numbers.")
    yield from _torques(result, joints)
    yield from _errors(result)
    if result.agreement is not None:
        yield from agreement.blocks(result.agreement)
    if result.learned is not None:
        yield from learned.blocks(result.learned, joints)
    yield from _open_ends(result)


def _lines(*texts: str, style: Style = "") -> Iterator[Block]:
    return (Line(text, style) for text in texts if text)


def _heading(text: str) -> Iterator[Block]:
    yield EMPTY
    yield Line(text, "bold")


def _causes(title: str, findings: Sequence[Finding], joints: Joints) -> Iterator[Block]:
    if not findings:
        return
    yield from _heading(title)
    rows = []
    for finding in findings:
        where = clean(finding.joint) if finding.joint is not None else "whole robot"
        lines = [f"{clean(name)} {fitted(value)}" for name, value in finding.parameters.items()]
        if finding.instead_of is not None:
            lines.append(finding.note)
        if finding.since is not None:
            lines.append(when(finding))
        rows.append(
            (
                f"{effect_name(finding.effect)}\n{where}",
                "\n".join(lines),
                percent(finding.probability),
                _removed(torque.removal(finding, joints)),
            )
        )
    heads = (("cause", False), ("numbers", False), ("is there", True), ("torque error", True))
    yield Table(heads, tuple(rows))
    yield EMPTY


def _removed(removal: torque.Removal | None) -> str:
    if removal is None:
        return NOTHING
    where = f"at {removal.where}" if removal.where else ""
    return "\n".join(line for line in (removal.short, where, removal.fall, removal.less) if line)


def _torques(result: Result, joints: Joints) -> Iterator[Block]:
    table = torque.table(result, joints, JOINTS)
    if table is None:
        return
    unit = f"{table.unit}, " if table.unit else ""
    yield from _heading(f"Torque error by joint ({unit}RMS, on data that the fit did not see)")
    after = "after" if result.findings else "tolerances"
    heads = ("joint", "torque", "before", after, "of before", "of torque", "x noise")
    yield Table(
        tuple((head, k > 0) for k, head in enumerate(heads)), tuple(astuple(row) for row in table.rows)
    )
    yield EMPTY
    yield Line(torque.reading(result), "dim")
    if table.more:
        yield Line(f"Of {table.more} more joints less is left.", "dim")


def _errors(result: Result) -> Iterator[Block]:
    gain = result.comparison
    errors = merit.channel_errors(gain)
    if gain is None or not errors:
        return
    worst = sorted(errors, key=lambda error: -error.before if error.before == error.before else 0.0)
    data = "on data that the fit did not see" if gain.held_out else "on the data of the fit"
    yield from _heading(f"Error of the simulation (NRMSE, {data})")
    two = bool(result.findings)
    rows = []
    for error in worst[:CHANNELS]:
        after = (number(error.after), percent(error.removed)) if two else ()
        rows.append(
            (f"{error.channel}.{clean(error.joint)}", number(error.before), *after, number(error.floor))
        )
    middle = (("after", True), ("removed", True)) if two else ()
    heads = (("channel", False), ("before" if two else "error", True), *middle, ("noise alone", True))
    yield Table(heads, tuple(rows))
    yield EMPTY
    if len(worst) > CHANNELS:
        yield Line(f"{len(worst) - CHANNELS} more channels err less.", "dim")


def _open_ends(result: Result) -> Iterator[Block]:
    if result.not_excited:
        joints: dict[str, list[str]] = {}
        for effect, joint in result.not_excited:
            joints.setdefault(effect_name(effect), []).extend([] if joint is None else [clean(joint)])
        yield from _heading("Not excited, so nothing is said of")
        yield Line(sentence("; ".join(f"{n} ({', '.join(j)})" if j else n for n, j in joints.items())))
    if result.within_tolerance:
        yield from _heading("Within the tolerance of the nominal numbers")
        sizes = (
            f"{cause(w.effect, w.joint)} {deviation(w.effect, w.value, w.joint in result.prismatic)}"
            for w in result.within_tolerance
        )
        yield Line(sentence(", ".join(sizes)))
    for note in result.notes:
        yield from _lines(sentence(capital(note)), style="dim")
