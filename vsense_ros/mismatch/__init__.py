"""Where model and recordings differ: found, named, modelled and proven."""
