"""On-vehicle virtual sensing: multibody state observers, their sensors and their recordings."""
