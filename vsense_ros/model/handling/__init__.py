"""Models of a car's handling with few degrees of freedom: names, equations, and nothing of filters."""
