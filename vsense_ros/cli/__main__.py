"""python -m vsense_ros.cli"""

from vsense_ros.cli import main

main(prog_name="vsense")
