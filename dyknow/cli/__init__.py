"""The command lines of `rosrun dyknow ...`; the layers below do the work."""
