"""Tables of the papers that the project follows, and examinations by its authors, one command each.

They need the repository: `python -m studies --help` in its folder. The installed package does not contain them.
"""
