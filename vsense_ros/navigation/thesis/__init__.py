"""Filters of Leung 2010 and of other papers, one file each, to repeat their tables and to compare with.

`vsense filters --all` lists them beside the recommended ones; `--filter NAME` takes them as well.
"""
