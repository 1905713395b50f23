# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How a camera is mounted on its owner; a detector needs this besides the intrinsics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Sequence, Tuple, Union

from dyknow_demo.soccer import ceiling, nao
from dyknow_demo.soccer.rigid import Array


@dataclass(frozen=True)
class NaoBottom:
    """The bottom camera in a NAO's head; moved by the robot's joints."""

    joints: Tuple[str, ...] = nao.JOINT_NAMES

    def owner_from_camera(self, angles: Sequence[float]) -> Array:
        """Pose of the optical frame for the angles (rad) of ``joints``."""
        return nao.robot_from_bottom_camera(nao.Posture(*angles))


@dataclass(frozen=True)
class Fixed:
    """A camera that does not move, above the origin of its own frame.

    Attributes:
        height: m above the floor.
        pitch: rad from the horizontal downwards.
        roll: rad about the line of sight.
    """

    height: float
    pitch: float
    roll: float = 0.0
    joints: Tuple[str, ...] = ()

    def owner_from_camera(self, angles: Sequence[float]) -> Array:
        """Pose of the optical frame, which depends on no joint."""
        return ceiling.floor_from_camera(self.height, self.pitch, self.roll)


Mount = Union[NaoBottom, Fixed]

_NUMBERS = ("height", "pitch", "roll")

#: The form that ``mount_of`` accepts, for error messages.
EXPECTED = "nao_bottom, or the numbers height (m, above 0), pitch and, optionally, roll (rad)"


def mount_of(given: Any) -> Mount:
    """Make a mount from the value of a parameter.

    Args:
        given: ``"nao_bottom"``, or a mapping with ``height``, ``pitch`` and perhaps ``roll``.

    Raises:
        ValueError: it is neither.
    """
    if given == "nao_bottom":
        return NaoBottom()
    if isinstance(given, dict):
        needed, named = {"height", "pitch"}, set(given)
        if needed <= named <= needed | {"roll"} and float(given["height"]) > 0:
            height, pitch, roll = (float(given.get(name, 0.0)) for name in _NUMBERS)
            return Fixed(height, pitch, roll)
    raise ValueError(f"expected {EXPECTED}")
