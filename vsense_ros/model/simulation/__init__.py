"""The car on its own: from inputs or a driver, and from recorded inputs."""
