from pathlib import Path

import pytest
import torch

from bunraku_lab.training.runs.half_precision import bf16_is_fast


def test_a_processor_without_bf16_in_hardware_is_not_asked_for_it():
    info = Path("/proc/cpuinfo")
    if not info.is_file() or "flags" not in info.read_text():
        pytest.skip("this system does not list the processor's instructions")
    flags = set(info.read_text().split())
    assert bf16_is_fast("cpu") == bool(flags & {"avx512_bf16", "amx_bf16"})
    assert bf16_is_fast(torch.device("cpu")) == bf16_is_fast("cpu")


def test_other_devices_have_none_that_is_known():
    assert not bf16_is_fast("meta")
