"""What the reconciler orders, and what it gets, as values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import AbstractSet, Dict, List, Mapping, Set, Tuple

from dyknow.manager.planning.problem import Plan


@dataclass(frozen=True)
class AssemblyRequest:
    """What is to be made, and around what.

    Attributes:
        plan: how.
        tag: what was asked for, for error messages.
        topic: where the client listens; empty for where the stream is.
        datatype: ROS type that was asked for; empty for any.
        own: healthy nodelets of the claim that can be re-wired, by label.
        unhealthy: nodelets that nothing is expected of any more.
        unresponsive: nodelets that do not answer.
        claim_id: whose stream it is; what other claims have is theirs.
        ordinary: topics on which ordinary nodes send what the library says.
    """

    plan: Plan
    tag: str = ""
    topic: str = ""
    datatype: str = ""
    own: Mapping[str, str] = field(default_factory=dict)
    unhealthy: AbstractSet[str] = frozenset()
    unresponsive: AbstractSet[str] = frozenset()
    claim_id: str = ""
    ordinary: AbstractSet[str] = frozenset()


@dataclass
class AssemblyResult:
    """What became of a plan.

    Attributes:
        topic: where the stream is published.
        datatype: its type.
        goal: nodelet and out-port; empty for a topic of ordinary nodes.
        wiring: for each nodelet of the stream the topics that its ports need.
        sources: topics of ordinary nodes.
        spawned: names of new nodelets.
        reused: names of nodelets that were there.
        remarks: what did not go as it should, in words.
        detail: what there is to say about the stream as it is now.
    """

    topic: str = ""
    datatype: str = ""
    goal: Tuple[str, str] = ("", "")
    wiring: Dict[str, Dict[str, str]] = field(default_factory=dict)
    sources: Set[str] = field(default_factory=set)
    spawned: List[str] = field(default_factory=list)
    reused: Set[str] = field(default_factory=set)
    remarks: List[str] = field(default_factory=list)
    detail: str = ""
