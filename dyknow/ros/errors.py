# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Exceptions of handles that are also rospy's, so that converted nodes still catch them."""

from __future__ import annotations

import rospy

from dyknow.errors import DyKnowError, HandleClosed


class ClosedHandle(HandleClosed, rospy.ROSException):
    """A handle was used after it was unregistered or its nodelet unloaded."""


class MessageTimeout(DyKnowError, rospy.ROSException):
    """A message did not come in time."""


class Interrupted(DyKnowError, rospy.ServiceException, rospy.ROSInterruptException):
    """The nodelet was unloaded during a wait."""
