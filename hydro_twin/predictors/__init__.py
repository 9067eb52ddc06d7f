"""The predictors: analytical, neural and hybrid, behind one interface."""
from hydro_twin.predictors.predictor import load, make_predictor, MODES, Predictor, Stepper

__all__ = ['MODES', 'Predictor', 'Stepper', 'load', 'make_predictor']
