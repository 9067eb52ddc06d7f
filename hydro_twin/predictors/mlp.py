"""The MLP of [B19]: a network gives the output, without physics."""
from __future__ import annotations

from hydro_twin.predictors.kind import Kind, Settings
from hydro_twin.predictors.network_predictor import load_network_predictor

MLP = Kind('mlp', 'an MLP', load_network_predictor, physics=False, network=Settings())
