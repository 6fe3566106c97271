"""Which adapter is taken, and what is said where none is."""

from __future__ import annotations

import builtins
from dataclasses import dataclass, field
from typing import Any

import pytest

from cags_common import raster
from cags_common.errors import ConfigError
from cags_common.raster import RenderOptions
from cags_gpu import device
from cags_gpu.device import Gpu, adapters, choose, why_unavailable
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser
from support.gpu import needs_adapter, software_passes
from support.raster_scenes import assert_sound, camera, random_splats


@dataclass
class Adapter:
    """What wgpu says of an adapter."""

    name: str
    kind: str = "DiscreteGPU"
    backend: str = "Vulkan"
    features: set[str] = field(default_factory=set)

    @property
    def info(self) -> dict[str, str]:
        words = {"device": self.name, "description": "driver 1", "adapter_type": self.kind}
        return words | {"backend_type": self.backend}

    @property
    def limits(self) -> dict[str, int]:
        return {"max-storage-buffer-binding-size": 1 << 27, "max-buffer-size": 1 << 28}


@pytest.fixture
def present(monkeypatch: pytest.MonkeyPatch) -> list[Adapter]:
    """The adapters that wgpu lists; a test fills in what it wants."""
    monkeypatch.setattr(device, "DEVICE_FILES", ("/dev/null",))
    wgpu = pytest.importorskip("wgpu")
    found: list[Adapter] = []
    monkeypatch.setattr(type(wgpu.gpu), "enumerate_adapters_sync", lambda self, **_: list(found))
    monkeypatch.delenv(device.SOFTWARE_VARIABLE, raising=False)
    monkeypatch.delenv(device.ADAPTER_VARIABLE, raising=False)
    return found


def test_hardware_comes_before_software_and_discrete_before_integrated(present: list[Adapter]) -> None:
    present += [Adapter("lavapipe", "CPU"), Adapter("Iris", "IntegratedGPU"), Adapter("RTX")]
    assert [info.name for info, _ in adapters()] == ["RTX", "Iris", "lavapipe"]
    assert choose()[0].name == "RTX"
    assert why_unavailable() == ""


def test_software_is_refused_unless_asked_for(present: list[Adapter], monkeypatch: pytest.MonkeyPatch) -> None:
    present.append(Adapter("lavapipe", "CPU"))
    assert "only software adapters are here (lavapipe (Vulkan, driver 1, software))" in why_unavailable()
    assert raster.chosen("auto") == "auto"
    monkeypatch.setenv(device.SOFTWARE_VARIABLE, "1")
    assert choose()[0].software


def test_without_a_device_file_wgpu_is_not_asked(present: list[Adapter], monkeypatch: pytest.MonkeyPatch) -> None:
    """It took a second, at every start of a client and of a server."""
    asked: list[None] = []
    monkeypatch.setattr(device, "DEVICE_FILES", ("/dev/no-such-processor*",))
    monkeypatch.setattr(device, "adapters", lambda: asked.append(None) or adapters())
    present.append(Adapter("lavapipe", "CPU"))
    monkeypatch.setattr(device.sys, "platform", "linux")
    assert why_unavailable() == "no device file of a graphics processor is here (/dev/no-such-processor*)"
    assert not asked
    assert choose(software=True)[0].name == choose(name="lava", software=True)[0].name == "lavapipe"
    assert "only software adapters are here" in refused(name="lava")
    monkeypatch.setattr(device.sys, "platform", "darwin")
    assert "only software adapters are here" in why_unavailable()


def refused(**wanted: Any) -> str:
    with pytest.raises(ConfigError) as refusal:
        choose(**wanted)
    return str(refusal.value)


@needs_adapter
def test_auto_draws_on_an_adapter_that_passes_and_says_in_one_line_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    with software_passes():
        assert raster.chosen("auto", told.append) == "gpu"
        assert told == []
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "no such adapter")
    assert raster.chosen("auto", told.append) == "auto"
    (reason,) = told
    assert "\n" not in reason
    assert "not drawing on a graphics processor: no adapter is called 'no such adapter'" in reason


def test_an_adapter_is_picked_by_a_part_of_its_name(present: list[Adapter], monkeypatch: pytest.MonkeyPatch) -> None:
    present += [Adapter("RTX 3080"), Adapter("Iris Xe", "IntegratedGPU")]
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "iris")
    assert choose()[0].name == "Iris Xe"
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "arc")
    assert "no adapter is called 'arc'" in why_unavailable()


def test_opengl_is_no_backend(present: list[Adapter]) -> None:
    present.append(Adapter("llvmpipe", "CPU", "OpenGL"))
    with pytest.raises(ConfigError, match="no adapter with Vulkan, Metal, D3D12 is here"):
        choose(software=True)


def test_without_an_adapter_the_backend_says_why_in_one_line(present: list[Adapter]) -> None:
    with pytest.raises(ConfigError) as refusal:
        raster.create("gpu")
    assert "\n" not in str(refusal.value)
    assert "install a driver" in str(refusal.value)
    assert raster.create(raster.chosen("auto")).name in ("cpu", "oracle")
    assert raster.chosen("cpu") == "cpu"


def test_without_wgpu_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def absent(name: str, *arguments: Any, **named: Any) -> Any:
        if name == "wgpu":
            raise ImportError("No module named 'wgpu'")
        return real(name, *arguments, **named)

    monkeypatch.setattr(device, "DEVICE_FILES", ("/dev/null",))
    monkeypatch.setattr(builtins, "__import__", absent)
    assert "pip install 'cags-stream[gpu]'" in why_unavailable()


@needs_adapter
def test_an_adapter_without_timestamps_draws() -> None:
    own = Keeper(lambda: Gpu(software=True, timestamps=False))
    assert not own.current().gpu.timestamps
    assert_sound(GpuRasteriser(own).load(random_splats(50)).render(camera(), RenderOptions()))
    own.close()
