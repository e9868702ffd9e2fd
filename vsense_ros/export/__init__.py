"""Writing an observer for machines that have no Python."""
