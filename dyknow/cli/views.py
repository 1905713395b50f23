# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Small questions about a nodelet of the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dyknow.similar import did_you_mean

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus


def state_of(nodelet: NodeletStatus) -> str:
    """Return its state: `starting`, `running`, `lost` or `failed`."""
    return nodelet.state.name.lower()


def unknown_nodelet(name: str, model: Model) -> str:
    """Write that there is no such nodelet, with similar names."""
    known = [nodelet.name for nodelet in model.nodelets]
    hint = did_you_mean(name, known) or "; see 'dyknow list'"
    return f"no nodelet named '{name}' runs{hint}"
