"""Room for many who connect to this node at once.

rospy's server has a queue of five connections. When a nodelet manager comes back, all who
subscribed to its topics connect within milliseconds; the kernel drops those that the queue has no
room for, and they try again after 1 s, then after 3 s.
"""

from __future__ import annotations

from rospy.impl.tcpros_base import init_tcpros_server

#: Connections that may wait to be accepted; the kernel's own bound is at least that everywhere.
QUEUE = 128


def make_room() -> None:
    """Lengthen the queue of this node's server, which is started if need be.

    The node must be initialised. To listen again on a socket that listens changes its queue and
    nothing else.
    """
    server = init_tcpros_server()
    server.start_server()
    server.tcp_ros_server.server_sock.listen(QUEUE)
