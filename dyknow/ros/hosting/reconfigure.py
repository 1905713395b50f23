# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters that a nodelet reads while it runs, by dynamic_reconfigure."""

from __future__ import annotations

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.specifications.values import value_of
from dyknow.model.transformation import Parameter
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: Seconds for the nodelet's answer.
_TIMEOUT = 2.0


def reconfigure(master: Master, nodelet: str, parameter: Parameter) -> bool:
    """Let a nodelet take a value at once; returns whether it has."""
    try:
        from dynamic_reconfigure import msg, srv  # few nodelets need it
    except ImportError:
        return False
    value = value_of(parameter)
    kinds = {
        bool: ("bools", msg.BoolParameter),
        int: ("ints", msg.IntParameter),
        float: ("doubles", msg.DoubleParameter),
        str: ("strs", msg.StrParameter),
    }
    if type(value) not in kinds:
        return False
    field, kind = kinds[type(value)]
    config = msg.Config(**{field: [kind(parameter.name, value)]})
    try:
        service = names.join(nodelet, "set_parameters")
        answer = ServiceClient(master, service, srv.Reconfigure).call(_TIMEOUT, config)
    except (HostError, PeerTimeout, LookupError):
        return False
    if field == "ints" and parameter.name in {each.name for each in answer.config.doubles}:
        return reconfigure(master, nodelet, parameter._replace(type="double"))  # C++ is strict
    taken = {each.name: each.value for each in getattr(answer.config, field)}
    return bool(taken.get(parameter.name) == value)
