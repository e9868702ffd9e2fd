"""The parts of a vehicle file that stand below sensors and effects: the nominal car and its suspensions."""
