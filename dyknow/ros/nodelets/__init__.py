"""The nodelet manager as a node, its services, and its clients."""
