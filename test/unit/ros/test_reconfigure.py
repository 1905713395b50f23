# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters that a nodelet takes at once, by dynamic_reconfigure."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, List

from dynamic_reconfigure.msg import Config, DoubleParameter

from dyknow.model.transformation import Parameter
from dyknow.ros.hosting import reconfigure


def test_a_double_takes_a_whole_number(monkeypatch):
    """A server in C++ passes over a parameter among those of another type."""
    rate = DoubleParameter("rate", 30.0)

    def call(timeout: float, config: Config) -> Any:
        for each in config.doubles:
            rate.value = each.value
        return SimpleNamespace(config=Config(doubles=[rate]))

    names: List[str] = []
    monkeypatch.setattr(
        reconfigure,
        "ServiceClient",
        lambda master, name, kind: names.append(name) or SimpleNamespace(call=call),
    )
    master: Any = None
    assert reconfigure.reconfigure(master, "/camera", Parameter("rate", "int", "5"))
    assert rate.value == 5.0
    assert names == ["/camera/set_parameters"] * 2
