"""The rqt plugin of DyKnow and its window of its own."""
