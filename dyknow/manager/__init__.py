"""The DyKnow manager: which nodelets can run, which do run, and how they are connected.

This layer is plain Python. It imports no ROS, and it reaches nodelets only through what is
handed to it, so all of it runs in tests without a roscore.
"""
