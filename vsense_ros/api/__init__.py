"""What people use from Python, and what the commands do: read recordings, estimate, identify, explain, save.

`import vsense_ros as vs` has all of it; the names are listed in `vsense_ros/__init__.py`, and each is imported when it
is first used. The command line calls the same functions.
"""
