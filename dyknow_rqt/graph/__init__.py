"""The graph that the window shows, and changes of it, as values; without Qt and ROS."""
