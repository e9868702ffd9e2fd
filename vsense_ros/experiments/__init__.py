"""What the project has measured, one command each: demo, Genesis laps, tables of the thesis, simplification."""
