# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Explains a plan: as a tree for people, and as a drawing in the language of Graphviz.

A part that is used more than once is new where it stands first and shared everywhere else, so the
prices add up to that of the plan. Instances of one transformation differ in their bindings, which
stand in brackets. The tree can be read back, so a tree that was sent by a service
can be drawn::

    FieldPosition(?what): cost 2 (proven least)
    └─ localization.position [?what=ball] (new, cost 1)
       └─ ball ← detector.ball (new, cost 1)
          ├─ planes ← subsampler.planes (runs as /subsampler_1)
          └─ joints ← /joint_states (topic)
"""

from __future__ import annotations

import re
from typing import NamedTuple

from dyknow.graphviz import quote
from dyknow.manager.planning.problem import Answer, Instance, Live, NoPlan, Plan, Source
from dyknow.manager.specifications.tags import written_bindings

_LINE = re.compile(r"(?P<lead>[ │├└]*─ )(?:(?P<port>\S+) ← )?(?P<what>.*) \((?P<how>[^()]*)\)\Z")
_INDENT = 3
_ABOVE = "shared, see above"
_TOPIC = "topic"


class Entry(NamedTuple):
    """A line of the tree: a supplier, at depth 0 that of the goal, and whether it runs or is new.

    It supplies an in-port, and is a transformation with out-port and bindings, or a topic.
    """

    depth: int
    port: str
    what: str
    how: str

    @property
    def parts(self) -> tuple[str, str]:
        """What it is, and its bindings, as in ``?camera=left``; empty for none."""
        what, mark, bindings = self.what.partition(" [?")
        return what, f"?{bindings[:-1]}" if mark else ""


def as_tree(answer: Answer) -> str:
    """Write a plan, or the missing demands, for people."""
    if isinstance(answer, NoPlan):
        reasons = [f"nothing supplies {each}" for each in answer.missing]
        reasons += map(str, answer.obstacles)
        *others, last = reasons or [answer.reason]
        lines = [f"{answer.demand}: no plan", *(f"├─ {each}" for each in others), f"└─ {last}"]
        return "\n".join(lines)
    lines = [f"{answer.demand}: cost {answer.cost} ({_how_good(answer)})"]
    if answer.latency or answer.demand.max_age:
        lines[0] += f", latency {answer.latency:g} s as stated"
    steps = {step.instance: step for step in answer.steps}
    charges = dict(answer.charges)
    waiting: list[tuple[str, bool, str, Source]] = [("", True, "", answer.goal)]
    seen: set[Instance] = set()
    while waiting:
        lead, is_last, port, source = waiting.pop()
        inputs: tuple[tuple[str, Source], ...] = ()
        if isinstance(source, Live):
            name = source.nodelet or source.topic
            how = f"runs as {name}" if source.nodelet else _TOPIC
            how += _charged(charges.pop(name, 0))
            what = f"{source.label}.{source.port}" if source.nodelet else name
        else:
            step, how = steps[source.instance], _ABOVE
            if source.instance not in seen:
                seen.add(source.instance)
                inputs = step.inputs
                how = f"new, cost {step.cost}" if step.cost else "at no cost"
                how += _charged(step.charge)
            names = written_bindings(source.instance.bindings)
            what = f"{source.label}.{source.port}" + (f" [{names}]" if names else "")
        arrow = f"{port} ← " if port else ""
        lines.append(f"{lead}{'└─ ' if is_last else '├─ '}{arrow}{what} ({how})")
        lead += "   " if is_last else "│  "
        below = [(lead, False, in_port, supplier) for in_port, supplier in inputs]
        if below:
            below[-1] = (lead, True, *inputs[-1])
        waiting += reversed(below)
    return "\n".join(lines)


def read_tree(text: str) -> tuple[str, list[Entry]]:
    """Read the title and the lines of a plan that ``as_tree`` wrote; else raise ValueError."""
    title, *lines = text.rstrip("\n").split("\n")
    entries = []
    for line in lines:
        found = _LINE.match(line)
        if found is None:
            raise ValueError(f"not a line of a plan: '{line}'")
        depth = len(found["lead"]) // _INDENT - 1
        entries.append(Entry(depth, found["port"] or "", found["what"], found["how"]))
    return title, entries


def tree_as_dot(text: str) -> str:
    """Draw the tree of a plan: new nodelets are dashed, topics are rectangles.

    Raises ValueError if the text is something else.
    """
    title, entries = read_tree(text)
    nodes: dict[str, str] = {}
    edges: list[str] = []
    path: list[str] = []
    for entry in entries:
        how, (what, bindings) = entry.how.split(", ")[0], entry.parts
        is_topic = how == _TOPIC
        name, _, out = (what, "", "") if is_topic else what.rpartition(".")
        label = f"{name} [{bindings}]" if bindings else name
        name = how if how.startswith("runs as ") else label
        if entry.how != _ABOVE:
            shape = "box" if is_topic else "ellipse"
            style = "dashed" if how == "new" else "solid"
            label = label if is_topic else f"{label}\n{entry.how}"
            node = f"  {quote(name)} [shape={shape}, style={style}, label={quote(label)}];"
            nodes.setdefault(name, node)  # the charge stands at its first place alone
        del path[entry.depth :]
        consumer = path[-1] if path else title
        arrow = f"  {quote(name)} -> {quote(consumer)}"
        edges.append(f"{arrow} [taillabel={quote(out)}, headlabel={quote(entry.port)}];")
        path.append(name)
    goal = f"  {quote(title)} [shape=plaintext];"
    body = [goal, *(nodes[name] for name in sorted(nodes)), *dict.fromkeys(edges)]
    return "digraph plan {\n  rankdir=LR;\n" + "\n".join(body) + "\n}\n"


def _how_good(plan: Plan) -> str:
    if plan.cost <= plan.least_cost:
        return "proven least"
    # Upwards and in whole numbers, of which costs may be too large for a float.
    excess = -(-100 * (plan.cost - plan.least_cost) // plan.least_cost) if plan.least_cost else 0
    known = f"at most {excess} % above the least possible" if excess else "perhaps not the least"
    return f"{known}; its time was over" if plan.is_cut_short else known


def _charged(charge: int) -> str:
    return f", charged {charge}" if charge else ""
