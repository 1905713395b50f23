# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Describes the changes from one model of the graph to the next."""

from __future__ import annotations

from typing import Dict, Iterator, List

from dyknow import names
from dyknow.model.graph import Model, NodeletStatus, State


def changes(before: Model, after: Model, space: str = "/") -> List[str]:
    """List nodelets that came, went or were re-wired, a line each.

    Out-ports that publish on the topic of their own name, as most do, are left out.

    Args:
        before: the earlier model.
        after: the later one.
        space: namespace that is left out of names.
    """
    old, new = _running(before), _running(after)
    lines = [f"+ {short(name, space)}" for name in sorted(new) if name not in old]
    for name in sorted(new):
        lines.extend(_wirings(old.get(name), new[name], space))
    lines += [f"- {short(name, space)}" for name in sorted(old) if name not in new]
    return lines


def short(name: str, space: str) -> str:
    """Leave a namespace out of a global name."""
    prefix = names.join(space, "")
    return name[len(prefix) :] if name.startswith(prefix) else name


def _running(model: Model) -> Dict[str, NodeletStatus]:
    return {each.name: each for each in model.nodelets if each.state is State.RUNNING}


def _wirings(old: NodeletStatus | None, new: NodeletStatus, space: str) -> Iterator[str]:
    for port in new.ports:
        before = old.port(port.name) if old is not None else None
        was = before.topic if before is not None else ""
        is_usual = port.direction == "out" and port.topic == names.join(new.name, port.name)
        if was == port.topic or is_usual:
            continue
        place = f"{short(new.name, space)}.{port.name}"
        arrow = "<-" if port.direction == "in" else "->"
        what = f"{place} {arrow} {short(port.topic, space) or 'nothing'}"
        yield f"  {what} (was {short(was, space)})" if was else f"  {what}"
