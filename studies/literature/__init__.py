"""Filters that Leung 2010 describes in chapter 2 and does not use, one short file each: what they find in a small
simulation whose truth is known.

Each file has its state space, the equations of the thesis that it follows, and `examine`, which gives its rows of the
table of `python -m studies literature`. They are studies: for use on a car there is `vsense_ros.navigation`.
"""
