"""Forces on the car, evaluated for many lanes at once. Every array ends with the axis of lanes."""
