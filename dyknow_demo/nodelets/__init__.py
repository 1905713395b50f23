"""The nodelets of the demonstration: a camera, two stages, and one that keeps account."""
