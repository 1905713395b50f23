# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The soccer case study: where is the ball on the field?

Bottom to top: geometry (``rigid``, ``pinhole``, ``nao``, ``ceiling``), the simulated truth
(``field``, ``ball``, ``robot``, ``world``) and what cameras see of it (``yuv``, ``scenery``,
``sphere``, ``camera``), the robot's own vision (``planes``, ``colour``, ``outline``, ``finder``,
``sighting``), and ``nodelets`` around them. Beside it, the demonstration: ``command``, ``stage``,
``story``, and what they show (``observing``, ``track``, ``narration``, ``picture``). Only
``nodelets``, ``planes_message``, ``stage``, ``story`` and ``observing`` use ROS.
"""
