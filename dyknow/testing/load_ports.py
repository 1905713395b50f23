# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports that a load request connects."""

from __future__ import annotations

from typing import Collection, Dict, Mapping

from dyknow import names
from dyknow.errors import UnknownPort


def remappings_of_ports(nodelet: str, ports: Mapping[str, str]) -> Dict[str, str]:
    """Return the remappings, of global names, that connect ports of a nodelet at its load.

    What a port's name resolves to depends on the handle that declares it, which is not known yet:
    each is remapped in the namespace that the nodelet stands in and in its own.
    """
    return {
        names.resolve(port, namespace, nodelet): names.resolve(topic, "/", nodelet)
        for port, topic in ports.items()
        for namespace in (names.parent(nodelet), nodelet)
    }


def check_ports(wanted: Collection[str], known: Collection[str]) -> None:
    """Raise UnknownPort if a wanted port is not there."""
    for port in wanted:
        if port not in known:
            raise UnknownPort(port, known)
