"""What is measured and tried on simulated drives, one command each: demo, Genesis laps, tables of papers, designs."""
