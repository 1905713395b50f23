# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Every line of DyKnow that knows rospy or a message.

Programs of users import ``acquiring``, ``client`` and ``parameters``. In folders: ``wire`` (calls
and messages), ``process`` (processes of this machine), ``transport`` (the bus over rospy),
``bonding`` (bonds), ``scripts`` (code that knows nothing of DyKnow), ``nodelets`` (the nodelet
manager as a node), ``hosting`` (how the DyKnow manager reaches nodelet managers), ``manager`` (the
DyKnow manager as a node) and ``shell`` (the command line's client, and the doctor).
"""
