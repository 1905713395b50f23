"""The DyKnow manager as a node: its services, parameters and topics."""
