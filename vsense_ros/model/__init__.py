"""The car, its tyres, sensors and effects as CasADi expressions, each written once."""
