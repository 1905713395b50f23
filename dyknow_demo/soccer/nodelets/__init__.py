"""The nodelets of the soccer case study, as the paper lists them, and the simulated sources."""
