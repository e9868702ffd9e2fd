"""python -m studies"""

from studies.commands import main

main(prog_name="python -m studies")
