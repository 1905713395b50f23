"""The computation graph, as values: the paper's GetModel."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Mapping, Tuple


class State(enum.IntEnum):
    """State of a nodelet; the numbers are those of ``dyknow_msgs/Nodelet``."""

    STARTING = 0
    RUNNING = 1
    LOST = 2
    FAILED = 3


@dataclass(frozen=True)
class PortState:
    """A port of a running nodelet.

    Attributes:
        name: unique in the nodelet.
        direction: ``in`` or ``out``.
        datatype: ROS type, empty when not known yet.
        topic: global name, empty when disconnected.
        tags: those of the transformation.
    """

    name: str
    direction: str
    datatype: str = ""
    topic: str = ""
    tags: Tuple[str, ...] = ()


@dataclass(frozen=True)
class SpawnRequest:
    """What a spawn asks for.

    Attributes:
        label: of the transformation.
        name: of the new nodelet.
        config: topics by port; ports that are not named start disconnected.
        is_protected: refuse to destroy it.
        isolated: give it a process of its own.
        manager: nodelet manager to use; empty for the manager's choice.
    """

    label: str
    name: str
    config: Mapping[str, str] = field(default_factory=dict)
    is_protected: bool = False
    isolated: bool = False
    manager: str = ""
