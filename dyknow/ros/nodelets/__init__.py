"""The nodelet manager as a node, its services, and those who ask it."""
