"""Filters of any system: state spaces, extended and unscented Kalman filters, late data, smoothers. It names no car."""
