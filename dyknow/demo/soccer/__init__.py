"""The soccer case study: where is the ball on the field?

Bottom to top: geometry (``rigid``, ``pinhole``, ``nao``, ``ceiling``), the simulated truth
(``field``, ``ball``, ``robot``, ``world``) and what cameras see of it (``yuv``, ``scenery``,
``sphere``, ``camera``), the robot's own vision (``planes``, ``colour``, ``outline``, ``finder``,
``sighting``), and ``nodelets`` around them. Nothing but ``nodelets`` and ``planes_message`` knows
ROS.
"""
