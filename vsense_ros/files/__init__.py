"""The files of a user: vehicles and tyres as YAML, .tir, their schema, and how files are found and written."""
