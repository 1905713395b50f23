# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Names that tell each camera frame from every other.

A frame's name travels in ``header.frame_id``, which every stage copies: rospy overwrites
``header.seq`` with a count of its own as soon as a node of another process listens.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameName:
    """One frame of one camera.

    Attributes:
        camera: name of the camera.
        number: counts the camera's frames from 0.
    """

    camera: str
    number: int

    def __str__(self) -> str:
        return f"{self.camera}#{self.number}"

    @classmethod
    def parse(cls, text: str) -> FrameName:
        """Read a name back.

        Raises:
            ValueError: it is not of the form ``camera#number``.
        """
        camera, separator, number = text.rpartition("#")
        if not separator:
            raise ValueError(f"'{text}' names no camera frame: expected 'camera#number'")
        return cls(camera, int(number))
