# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``rosrun dyknow dyknow_rqt``: the window on its own, without rqt."""

from __future__ import annotations

import argparse
import os
import signal
import sys

from python_qt_binding.QtCore import QSettings, Qt, QTimer
from python_qt_binding.QtWidgets import QApplication, QMainWindow
from rosgraph import myargv

from dyknow_rqt.monitoring.ros_remote import RosRemote
from dyknow_rqt.window import DyKnowWidget, spare_imports


class DyKnowWindow(QMainWindow):
    """Contains the widget and saves its settings."""

    def __init__(self, widget: DyKnowWidget, settings: QSettings) -> None:
        super().__init__()
        self._widget, self._settings = widget, settings
        self.setCentralWidget(widget)
        self.setWindowTitle("DyKnow")
        self.resize(1400, 800)
        geometry = settings.value("geometry")
        if geometry is not None:
            self.restoreGeometry(geometry)
        widget.restore({name: settings.value(name) for name in widget.state()})

    def closeEvent(self, event: object) -> None:  # noqa: N802
        for name, value in self._widget.state().items():
            self._settings.setValue(name, value)
        self._settings.setValue("geometry", self.saveGeometry())
        self._widget.shut_down()
        super().closeEvent(event)


def _has_screen() -> bool:
    """Whether Qt finds something to draw on; where it does not, it aborts the process."""
    given = ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(map(os.environ.get, given))


def main(argv: list[str] | None = None) -> int:
    """Run the window until it is closed; returns the exit code."""
    words = myargv(argv if argv is not None else sys.argv)
    parser = argparse.ArgumentParser(
        prog="dyknow_rqt", description="Shows the computation graph of DyKnow, and changes it."
    )
    parser.add_argument(
        "--manager",
        default="dyknow_manager",
        help="node name of the manager (default: %(default)s)",
    )
    arguments = parser.parse_args(words[1:])
    if not _has_screen():
        print(
            "dyknow_rqt: there is no screen: set DISPLAY, log in with 'ssh -X', or use the "
            "command line, 'rosrun dyknow dyknow --help'",
            file=sys.stderr,
        )
        return 1
    QApplication.setAttribute(Qt.AA_UseHighDpiPixmaps)
    application = QApplication(words[:1])
    application.setApplicationName("DyKnow")
    widget = DyKnowWidget(RosRemote(arguments.manager))
    window = DyKnowWindow(widget, QSettings("dyknow", "dyknow_rqt"))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *unused: window.close())
    # Python runs signal handlers only between its own instructions: a timer executes some.
    alive = QTimer()
    alive.timeout.connect(lambda: None)
    alive.start(200)
    spare_imports()
    window.show()
    widget.start()
    return int(application.exec_())
