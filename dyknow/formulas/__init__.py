# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas over streams: metric temporal logic on the messages of ports, without ROS.

::

    monitor = dyknow.formulas.parse("historically[0 s, 5 s] battery.percentage > 0.2").monitor()
    for verdict in monitor.feed("battery", message, received=rospy.Time.now()):
        print(verdict)
"""

from dyknow.formulas.monitor import Formula, Monitor, Range, Truth, Verdict, parse
from dyknow.formulas.types import MessageType

__all__ = ["Formula", "MessageType", "Monitor", "Range", "Truth", "Verdict", "parse"]
