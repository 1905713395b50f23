# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Other programs that show a topic, or the log of a nodelet."""

from __future__ import annotations

import shutil
from functools import partial
from typing import NamedTuple, Optional, Sequence, Tuple

from python_qt_binding.QtCore import QProcess
from python_qt_binding.QtWidgets import QMenu

#: Types of messages that are images.
IMAGES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
_TERMINAL = ("x-terminal-emulator", "-e", "rostopic", "echo")


class Viewer(NamedTuple):
    """A program.

    Attributes:
        title: for people.
        words: the command, in which ``{topic}``, ``{field}`` and ``{name}`` are replaced.
        is_for_images: whether it shows images, or everything else; None for both.
    """

    title: str
    words: Tuple[str, ...]
    is_for_images: Optional[bool] = None

    def is_there(self) -> bool:
        programs = ("rostopic", self.words[0]) if self.words[:4] == _TERMINAL else self.words[:1]
        return all(shutil.which(each) for each in programs)

    def start(self, topic: str, field: str, name: str) -> None:
        """Start it; it outlives the window."""
        field = "/" + field.replace(".", "/") if field else ""
        words = [word.format(topic=topic, field=field, name=name) for word in self.words]
        QProcess.startDetached(words[0], words[1:])


VIEWERS = (
    Viewer("rqt_image_view", ("rqt_image_view", "{topic}"), True),
    Viewer("rqt_plot", ("rqt_plot", "{topic}{field}"), False),
    Viewer("rostopic echo", (*_TERMINAL, "{topic}")),
)
LOG_VIEWERS = (
    Viewer("rqt_console", ("rqt_console",)),
    Viewer("rostopic echo", (*_TERMINAL, "--filter", "m.name == '{name}'", "/rosout")),
)


def add_viewers(
    menu: QMenu,
    viewers: Sequence[Viewer],
    datatype: str = "",
    topic: str = "",
    field: str = "",
    name: str = "",
) -> None:
    """Add the programs that show something; those that are not installed are greyed."""
    for viewer in viewers:
        if viewer.is_for_images in (None, datatype in IMAGES):
            action = menu.addAction(viewer.title)
            action.setEnabled(viewer.is_there())
            start = partial(viewer.start, topic, field, name)
            action.triggered.connect(lambda checked=False, start=start: start())
