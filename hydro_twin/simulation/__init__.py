"""Recordings made from the physics, by an integrator that the predictors know nothing of."""
