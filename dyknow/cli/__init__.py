"""The command lines of `rosrun dyknow ...`; what they do is in the layers below."""
