"""Numbers of a vehicle file found from recordings."""
