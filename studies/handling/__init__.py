"""Models of a car's handling that the study of Leung 2010 compares."""
