# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every line of DyKnow that knows rospy or a message.

In packages of their own: ``transport`` (the bus over rospy), ``bonding`` (bonds), ``scripts``
(code that knows nothing of DyKnow), ``nodelets`` (the nodelet manager as a node), ``hosting`` (how
the DyKnow manager reaches nodelet managers) and ``manager`` (the DyKnow manager as a node). The
modules here ask the DyKnow manager from outside, or serve all of those.
"""
