# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The rqt plugin; the only module that imports rqt."""

from __future__ import annotations

from typing import Any

from python_qt_binding.QtCore import QTimer
from rqt_gui_py.plugin import Plugin

from dyknow_rqt.monitoring.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget, make_room, spare_imports

_KEY = "dyknow"
#: Milliseconds until rqt has shown its window.
_AFTER_RQT = 500


class DyKnowPlugin(Plugin):
    """Docks the window into rqt; rqt has initialised the node."""

    def __init__(self, context: Any) -> None:
        super().__init__(context)
        self.setObjectName("DyKnowPlugin")
        self._widget = DyKnowWidget(RosRemote(_manager(context.argv())))
        if context.serial_number() > 1:
            self._widget.setWindowTitle(f"DyKnow ({context.serial_number()})")
        spare_imports()
        context.add_widget(self._widget)
        self._widget.start()
        # Later: rqt restores its own size after this.
        later = QTimer(self._widget, singleShot=True, interval=_AFTER_RQT)
        later.timeout.connect(lambda: make_room(self._widget))
        later.start()

    def shutdown_plugin(self) -> None:
        self._widget.shut_down()

    def save_settings(self, plugin_settings: Any, instance_settings: Any) -> None:
        for name, value in self._widget.state().items():
            instance_settings.set_value(f"{_KEY}_{name}", value)

    def restore_settings(self, plugin_settings: Any, instance_settings: Any) -> None:
        names = self._widget.state()
        self._widget.restore({name: instance_settings.value(f"{_KEY}_{name}") for name in names})


def _manager(argv: Any) -> str:
    """The name of the manager, from ``rqt --args --manager NAME`` or the default."""
    words = list(argv)
    if "--manager" in words[:-1]:
        return str(words[words.index("--manager") + 1])
    return "dyknow_manager"
