"""The predictors: analytical, neural and hybrid, behind one interface."""
from hydro_twin.predictors.predictor import MODES, Predictor, Stepper, load, make_predictor

__all__ = ['MODES', 'Predictor', 'Stepper', 'load', 'make_predictor']
