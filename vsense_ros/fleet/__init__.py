"""Many cars at once: each is explained in a process of its own, and what is found stands in one report."""
