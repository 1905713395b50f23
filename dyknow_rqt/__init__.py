"""The window of DyKnow, as an rqt plugin and on its own."""
