"""The GRU: a recurrent network gives the output, without physics."""
from __future__ import annotations

from hydro_twin.predictors.kind import Kind, Settings
from hydro_twin.predictors.network_predictor import load_network_predictor

GRU = Kind('gru', 'a GRU', load_network_predictor, physics=False,
           network=Settings(hidden=(42,), decay=0.0, cell='gru'))   # 7225 weights; an MLP 7239
