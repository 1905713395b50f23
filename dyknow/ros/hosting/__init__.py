"""How the DyKnow manager starts, finds and reaches the nodelet managers of every kind."""
