"""Inputs that nobody meant, over everything that reads: `make fuzz`."""
