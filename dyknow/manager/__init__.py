# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager: which nodelets can run, which do run, and how they are connected.

This layer is plain Python. It imports no ROS, and it reaches nodelets only through its
injected collaborators, so all of it runs in tests without a roscore.

Three parts of it are packages of their own: ``specifications`` (the library), ``planning`` (the
cheapest way to a stream) and ``claims`` (streams on request, on top of everything else). The
modules here are the manager itself: the model and the graph, the library and the durable store,
the life of nodelets, the observer, and the seam to the host that runs them.
"""
