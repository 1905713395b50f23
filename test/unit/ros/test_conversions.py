# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages of one type in several classes, where they come from outside."""

from __future__ import annotations

import numpy as np
import pytest
from rospy.numpy_msg import numpy_msg
from std_msgs.msg import Int32MultiArray

from dyknow.ros.transport.conversions import TypedReceiver

ARRAYS = numpy_msg(Int32MultiArray)


@pytest.mark.parametrize("wanted, other", [(ARRAYS, Int32MultiArray), (Int32MultiArray, ARRAYS)])
def test_the_first_subscriber_of_a_process_does_not_decide_about_the_class(wanted, other):
    received = []
    receiver = TypedReceiver("/numbers", wanted, received.append)
    own = wanted(data=np.array([3], np.int32))
    message = other(data=np.array([1, 2], np.int32))
    message._connection_header = {"callerid": "/camera"}
    receiver.push(own)
    receiver.push(message)
    assert received[0] is own
    assert (type(received[1]), list(received[1].data)) == (wanted, [1, 2])
    assert received[1]._connection_header == {"callerid": "/camera"}
