"""The workbench: every stage from a vehicle file to an explained drive in a local browser page."""
