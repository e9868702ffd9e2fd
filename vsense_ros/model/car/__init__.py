"""The car as equations: the simplified one with 14 degrees of freedom, and the full one with all its bodies."""
