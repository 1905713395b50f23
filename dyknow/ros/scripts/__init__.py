# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Code of rospy that knows nothing of DyKnow, as a nodelet: scripts, and libraries in nodelets.

Such code is given modules of its own (``dyknow.nodelet.loading.importer``) and *views* of rospy
and of the parts of Python that belong to the process. Their effects are those of one nodelet: its
topics are ports, and they end with it.
"""
