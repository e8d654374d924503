"""Networks of torch as `bunraku` runs them: what a training is judged by, and what tests hold together."""

from __future__ import annotations

import numpy as np
from torch import nn

from bunraku.anatomy.handles import networks
from bunraku.apparel.learned import network as displacement
from bunraku.core.nn.layers import Weights
from bunraku.generation import denoiser, extractor
from bunraku.generation import denoiser as examples
from bunraku_lab.nn.apparel import DisplacementNetwork
from bunraku_lab.nn.denoiser import Denoiser, RetrievedExamples
from bunraku_lab.nn.handles import HandlePredictor, OrientationPredictor
from bunraku_lab.nn.text import Extractor


def arrays_of(model: nn.Module) -> dict[str, np.ndarray]:
    """The weights of a network by name, float32 on the CPU; later changes of the network do not change them."""
    return {name: value.detach().float().cpu().numpy().copy() for name, value in model.state_dict().items()}


def running_denoiser(model: Denoiser) -> denoiser.Denoiser:
    """A denoiser."""
    return denoiser.Denoiser(model.config, Weights(arrays_of(model)), dict(model.notes))


def running_extractor(model: Extractor) -> extractor.Extractor:
    """An extractor, a ranker or a critic."""
    return extractor.Extractor(model.config, Weights(arrays_of(model)), dict(model.notes))


def running_orientation(model: OrientationPredictor) -> networks.OrientationPredictor:
    """An orientation predictor."""
    return networks.OrientationPredictor(model.config, Weights(arrays_of(model)))


def running_predictor(model: HandlePredictor) -> networks.HandlePredictor:
    """A handle predictor."""
    return networks.HandlePredictor(model.config, Weights(arrays_of(model)))


def running_displacement(model: DisplacementNetwork) -> displacement.DisplacementNetwork:
    """A displacement network of apparel."""
    return displacement.DisplacementNetwork(model.config, Weights(arrays_of(model)))


def running_examples(found: RetrievedExamples) -> examples.RetrievedExamples:
    """Captured examples as arrays."""
    return examples.RetrievedExamples(*(part.cpu().numpy() for part in (found.values, found.lengths, found.pooled)))
