# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story of a claim, from a bag of the nodelet dyknow/BlackBox."""

from __future__ import annotations

from typing import Any, Iterator, NamedTuple

import rosbag
from dyknow_msgs.msg import Verdict

from dyknow.errors import DyKnowError
from dyknow.model.graph import State
from dyknow.ros.formulas.bags import bag_errors
from dyknow.ros.wire.messages import event_from


class StoryLine(NamedTuple):
    """Something that happened: ROS time in s, a claim, nodelet or topic, and what."""

    when: float
    subject: str
    what: str


def moments(path: str, claim: str = "") -> list[StoryLine]:
    """Read the changes of claims, verdicts and nodelets in a bag.

    With a ``claim`` other claims, and nodelets that it never had, are left out.

    Raises:
        DyKnowError: the bag cannot be read, or has no event of that claim.
    """
    with bag_errors(path), rosbag.Bag(path) as bag:
        messages = [(topic, m, when.to_sec()) for topic, m, when in bag.read_messages()]
    events = [(m, when) for _, m, when in messages if m._type == "dyknow_msgs/StreamEvent"]
    own = [(m, when) for m, when in events if claim in ("", m.after.claim_id)]
    if claim and not own:
        known = sorted({m.after.claim_id for m, _ in events})
        raise DyKnowError(
            f"bag '{path}' has no event of claim '{claim}'; "
            f"it has {', '.join(known) if known else 'no event of any claim'}"
        )
    parts = {name for m, _ in own for status in (m.before, m.after) for name in status.nodelets}
    with bag_errors(path):  # its messages may have values that mean nothing
        found = [
            *_of_claims(own),
            *_of_verdicts(messages),
            *_of_nodelets(messages, parts, not claim),
        ]
    return sorted(found, key=lambda moment: moment.when)


def _of_claims(events: list[tuple[Any, float]]) -> Iterator[StoryLine]:
    for message, when in events:
        event = event_from(message)
        after = event.after.state.name.lower()
        if event.before is None:
            change = f"is {after}"
        elif event.before.state is event.after.state:
            change = f"stays {after}"
        else:
            change = f"{event.before.state.name.lower()} → {after}"
        text = f"{event.after.bound_tag} {change}: {event.reason}"
        detail = event.after.detail
        yield StoryLine(
            when, event.after.claim_id, text + (f" ({detail})" if detail not in text else "")
        )


def _of_verdicts(messages: list[tuple[str, Any, float]]) -> Iterator[StoryLine]:
    values: dict[str, int] = {}
    words = {Verdict.FALSE: "false", Verdict.TRUE: "true", Verdict.UNKNOWN: "unknown"}
    for topic, message, when in messages:
        if message._type == "dyknow_msgs/Verdict" and values.get(topic) != message.value:
            values[topic] = message.value
            why = f": {message.why}" if message.why else ""
            yield StoryLine(when, topic, f"verdict {words[message.value]}{why}")


def _of_nodelets(
    messages: list[tuple[str, Any, float]], names: set[str], is_any: bool
) -> Iterator[StoryLine]:
    known: dict[str, tuple[int, str]] = {}
    is_first = True
    for _, message, when in messages:
        if message._type != "dyknow_msgs/Model":
            continue
        now = {each.name: (each.state, each.detail) for each in message.nodelets}
        for name in sorted(now.keys() | known.keys()) if not is_first else ():
            if now.get(name) != known.get(name) and (is_any or name in names):
                yield StoryLine(when, name, _state(now.get(name)))
        known, is_first = now, False


def _state(found: tuple[int, str] | None) -> str:
    if found is None:
        return "is gone"
    state, detail = State(found[0]).name.lower(), found[1]
    return f"is {state}" + (f": {detail}" if detail else "")
