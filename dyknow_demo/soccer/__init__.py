# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The soccer case study: where is the ball on the field?

``geometry``; the simulated truth, ``world``, and the cameras' view of it, ``rendering``; the
robot's vision, ``finder``, ``learnt`` and ``sighting``; the ``nodelets`` around all
that. ``evaluate`` and ``learn`` measure it.
"""
