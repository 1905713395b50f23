"""What the window shows and how it is changed, as values: nothing here knows Qt or ROS."""
