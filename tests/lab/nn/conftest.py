import pytest

from bunraku_lab.nn.text import tensors_of


@pytest.fixture
def encoder(encoder):
    """The small text encoder, whose batches are tensors."""

    class Tensors:
        name, token_size, pooled_size = encoder.name, encoder.token_size, encoder.pooled_size

        @staticmethod
        def encode(sentences):
            return tensors_of(encoder.encode(sentences))

    return Tensors
