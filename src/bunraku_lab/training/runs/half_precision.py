"""Where matrix products in bfloat16 are faster than in float32."""

from __future__ import annotations

import torch

__all__ = ["bf16_is_fast"]


def bf16_is_fast(device: torch.device | str) -> bool:
    """Whether a device has bfloat16 in hardware. A processor without it can compute in it too, sixty times as slowly as
    in float32.

    Args:
        device: Of torch.
    """
    kind = torch.device(device).type
    if kind == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return kind == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
