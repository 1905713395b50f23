"""Short looks at a nodelet as the manager shows it."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Dict

if TYPE_CHECKING:
    from dyknow.ros.client import ModelView, NodeletView


def state_of(nodelet: NodeletView) -> str:
    """Its state in a word: `starting`, `running`, `lost` or `failed`."""
    return nodelet.state.name.lower()


def connections_of(nodelet: NodeletView) -> Dict[str, str]:
    """Topics of the ports that are connected."""
    return {port.name: port.topic for port in nodelet.ports if port.topic}


def unknown_nodelet(name: str, model: ModelView) -> str:
    """Say that there is no such nodelet, and which similar ones there are."""
    known = [nodelet.name for nodelet in model.nodelets]
    similar = difflib.get_close_matches(name, known, 3)
    hint = f"; did you mean {' or '.join(similar)}?" if similar else "; see 'dyknow list'"
    return f"no nodelet named '{name}' runs{hint}"
