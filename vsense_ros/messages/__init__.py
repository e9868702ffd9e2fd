"""Messages as numbers and as bytes: recordings, topics, message definitions, CDR, diagnostics. No ROS, no car."""
