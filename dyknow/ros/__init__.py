"""Every line of DyKnow that knows rospy or a message: nodes, services, the bus's outside."""
