"""Multibody formulations in relative coordinates: open trees and closed loops."""
