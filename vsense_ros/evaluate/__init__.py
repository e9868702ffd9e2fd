"""Comparison of what was estimated with what is known to be true: scores, pictures, reports."""
