"""Short looks at a nodelet as the manager shows it."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Dict, Iterable, List, Mapping

if TYPE_CHECKING:
    from dyknow.manager.model import PortState
    from dyknow.ros.views import ModelView, NodeletView


def state_of(nodelet: NodeletView) -> str:
    """Its state in a word: `starting`, `running`, `lost` or `failed`."""
    return nodelet.state.name.lower()


def by_name(ports: Iterable[PortState]) -> List[PortState]:
    """Sort ports: the manager shows them in the order in which the nodelet made them."""
    return sorted(ports, key=lambda port: port.name)


def connections_of(nodelet: NodeletView) -> Dict[str, str]:
    """Topics of the ports that are connected, by port."""
    return {port.name: port.topic for port in by_name(nodelet.ports) if port.topic}


def unknown_nodelet(name: str, model: ModelView) -> str:
    """Say that there is no such nodelet, and which similar ones there are."""
    known = [nodelet.name for nodelet in model.nodelets]
    similar = difflib.get_close_matches(name, known, 3)
    hint = f"; did you mean {' or '.join(similar)}?" if similar else "; see 'dyknow list'"
    return f"no nodelet named '{name}' runs{hint}"


def shows(model: ModelView, wanted: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether the model has these topics at these ports, nodelet by nodelet."""
    for name, topics in wanted.items():
        nodelet = model.nodelet(name)
        if nodelet is None:
            return False
        present = connections_of(nodelet)
        if any(present.get(port, "") != topic for port, topic in topics.items()):
            return False
    return True
