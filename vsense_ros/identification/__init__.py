"""Identification: parameters of a car, found from recordings by nonlinear least squares and by maximum likelihood."""
