"""The bus over rospy: registrations, topics, and the link inside the process."""
