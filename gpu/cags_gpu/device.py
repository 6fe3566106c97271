"""Adapters and devices: which one is used, why none is, and what its limits are.

Hardware behind Vulkan, Metal or Direct3D 12 only. On Linux without a device file of any wgpu is not loaded: finding
nothing would take a second at every start of a program. Software adapters (lavapipe, SwiftShader, WARP) are slower than
the ``cpu`` backend; tests ask for one with ``CAGS_GPU_SOFTWARE=1``. ``CAGS_GPU_ADAPTER`` picks by a part of the name.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from glob import glob
from importlib import resources
from typing import Any, TypeAlias

from cags_common.errors import ConfigError

Handle: TypeAlias = Any  # an object of wgpu, which is not typed

SOFTWARE_VARIABLE = "CAGS_GPU_SOFTWARE"
ADAPTER_VARIABLE = "CAGS_GPU_ADAPTER"
BACKENDS = ("Vulkan", "Metal", "D3D12")
LIMITS = ("max-storage-buffer-binding-size", "max-buffer-size")
"""What a device is asked for beyond WebGPU's defaults: as much as the adapter has."""

DEVICE_FILES = (
    "/dev/dri/render*",  # the kernel's own drivers
    "/dev/nvidia[0-9]*",
    "/dev/nvgpu*",  # Tegra
    "/dev/dxg",  # Windows' processors in WSL
    "/dev/kgsl-3d0",  # Adreno
    "/dev/mali*",
    "/dev/pvr*",
)
"""What Linux shows of a graphics processor."""

STORAGE_BUFFERS = 8
WORKGROUP_BYTES = 16384
LEAST_BINDING_BYTES = 1 << 27
"""WebGPU's defaults, which the shaders stay within."""


@dataclass(frozen=True, slots=True)
class AdapterInfo:
    """What a person wants to know of an adapter."""

    name: str
    driver: str
    backend: str  # Vulkan, Metal or D3D12
    software: bool
    timestamps: bool
    max_binding_bytes: int
    max_buffer_bytes: int

    def __str__(self) -> str:
        kind = ", software" if self.software else ""
        return f"{self.name} ({self.backend}, {self.driver or 'driver unknown'}{kind})"


class DeviceLostError(Exception):
    """The device went away (driver reset, unplugged, out of memory): it has to be made anew."""


def adapters() -> list[tuple[AdapterInfo, Handle]]:
    """Every adapter that the shaders run on, hardware first. Raises :class:`ConfigError` where wgpu is missing."""
    try:
        import wgpu
    except (ImportError, OSError) as error:
        raise ConfigError(f"wgpu cannot be loaded ({error}); pip install 'cags-stream[gpu]'") from error
    _without_display()
    try:
        found = [(_info(handle), handle) for handle in wgpu.gpu.enumerate_adapters_sync()]
    except Exception as error:  # wgpu raises what its native library says, in types of its own
        raise ConfigError(f"adapters cannot be listed: {_first_line(error)}") from error
    fit = [pair for pair in found if pair[0].backend in BACKENDS]
    return sorted(fit, key=lambda pair: (pair[0].software, pair[1].info["adapter_type"] != "DiscreteGPU"))


@cache
def _without_display() -> None:
    """Keep drivers from looking for a display, whose absence some report on standard error at every device."""
    from wgpu.backends.wgpu_native.extras import set_instance_extras

    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # where Wayland's library looks for a socket
    with suppress(RuntimeError):  # the process has made an instance before
        set_instance_extras(backends=("Vulkan", "Metal", "DX12"))


def software_allowed() -> bool:
    """Whether the environment lets software adapters pass: for tests."""
    return os.environ.get(SOFTWARE_VARIABLE, "") not in ("", "0")


def choose(software: bool | None = None, name: str | None = None) -> tuple[AdapterInfo, Handle]:
    """The adapter to use. Raises :class:`ConfigError` with the reason, in one line, where there is none."""
    software = software_allowed() if software is None else software
    name = os.environ.get(ADAPTER_VARIABLE, "") if name is None else name
    if not (software or name or _may_be_there()):
        raise ConfigError(f"no device file of a graphics processor is here ({', '.join(DEVICE_FILES)})")
    found = adapters()
    named = [pair for pair in found if name.lower() in pair[0].name.lower()]
    fit = [pair for pair in named if software or not pair[0].software]
    if fit:
        return fit[0]
    if not found:
        raise ConfigError(
            f"no adapter with {', '.join(BACKENDS)} is here; install a driver (Debian: mesa-vulkan-drivers)"
        )
    names = ", ".join(str(info) for info, _ in found)
    if not named:
        raise ConfigError(f"no adapter is called {name!r} ({ADAPTER_VARIABLE}); there are: {names}")
    raise ConfigError(f"only software adapters are here ({names}), which are slower than the backend 'cpu'")


def _may_be_there() -> bool:
    """Whether this machine may have a graphics processor."""
    return sys.platform != "linux" or any(map(glob, DEVICE_FILES))


def why_unavailable() -> str:
    """Why the ``gpu`` backend cannot be used here; empty when it can."""
    try:
        choose()
    except ConfigError as error:
        return str(error)
    return ""


class Gpu:
    """A device with its pipelines. ``lock`` is held while a frame is recorded and submitted."""

    def __init__(self, software: bool | None = None, name: str | None = None, *, timestamps: bool = True) -> None:
        self.info, self._adapter = choose(software, name)
        self.timestamps = self.info.timestamps and timestamps
        self.lock = threading.RLock()
        self.lost = False
        self.max_binding_bytes = self.info.max_binding_bytes
        self._made: dict[Any, Handle] = {}
        limits = {key: self._adapter.limits[key] for key in LIMITS}
        features = ["timestamp-query"] if self.timestamps else []
        try:
            self.device = self._adapter.request_device_sync(required_features=features, required_limits=limits)
        except Exception as error:
            raise ConfigError(f"{self.info} gives no device: {_first_line(error)}") from error

    def destroy(self) -> None:
        """Give the device back; what still uses it sees it as lost."""
        self.lost = True
        self.device.destroy()

    @contextmanager
    def used(self) -> Iterator[None]:
        """Hold the device while a frame is recorded. Raises :class:`DeviceLostError` where it is gone or out of memory.

        Other faults of wgpu are defects of the program and pass as they are.
        """
        with self.lock, self.watched():
            yield

    @contextmanager
    def watched(self) -> Iterator[None]:
        """As :meth:`used`, beside others that use it: to wait for it, and to read what it has done."""
        import wgpu

        if self.lost:
            raise DeviceLostError(f"{self.info} was lost")
        try:
            yield
        except (wgpu.GPUError, RuntimeError) as error:
            if not self.lost and not _tells_of_loss(error):
                raise
            self.lost = True
            raise DeviceLostError(f"{self.info} was lost: {_first_line(error)}") from error

    def buffer(self, size: int, *, uniform: bool = False, indirect: bool = False) -> Handle:
        """A buffer of at least 16 bytes that shaders read and write, or (``uniform``) only read."""
        import wgpu

        usage = wgpu.BufferUsage
        kind = usage.UNIFORM if uniform else usage.STORAGE | (usage.INDIRECT if indirect else 0)
        rounded = max(16, -(-size // 16) * 16)
        return self.device.create_buffer(size=rounded, usage=kind | usage.COPY_DST | usage.COPY_SRC)

    def uniform(self, data: bytes) -> Handle:
        """A uniform buffer that holds ``data``; equal data share one."""
        key = ("uniform", data)
        if key not in self._made:
            buffer = self.buffer(len(data), uniform=True)
            self.device.queue.write_buffer(buffer, 0, data)
            self._made[key] = buffer
        return self._made[key]

    def layout(self, accesses: Sequence[str | None]) -> Handle:
        """The bind-group layout of bindings that are ``uniform``, ``read``, ``write`` or (None) not used."""
        key = ("layout", tuple(accesses))
        if key not in self._made:
            kinds = {"uniform": "uniform", "read": "read-only-storage", "write": "storage"}
            entries = [
                {"binding": i, "visibility": 4, "buffer": {"type": kinds[access]}}  # 4: compute
                for i, access in enumerate(accesses)
                if access
            ]
            self._made[key] = self.device.create_bind_group_layout(entries=entries)
        return self._made[key]

    def pipeline(
        self, shader: str, entry: str, accesses: Sequence[str | None], constants: Mapping[str, bool]
    ) -> Handle:
        """The pipeline of an entry point, compiled once for each set of constants."""
        key = (shader, entry, tuple(sorted(constants.items())))
        if key not in self._made:
            layout = self.device.create_pipeline_layout(bind_group_layouts=[self.layout(accesses)])
            stage = {"module": self._module(shader), "entry_point": entry}
            stage["constants"] = {name: float(value) for name, value in constants.items()}
            self._made[key] = self.device.create_compute_pipeline(layout=layout, compute=stage)
        return self._made[key]

    def _module(self, shader: str) -> Handle:
        key = ("module", shader)
        if key not in self._made:
            self._made[key] = self.device.create_shader_module(label=shader, code=source(shader))
        return self._made[key]


WITH_COMMON = ("project", "bin", "ranges", "blend")
"""Shaders that ``common.wgsl`` stands before."""


@cache
def source(shader: str) -> str:
    """The WGSL of a shader, whole."""
    folder = resources.files("cags_gpu") / "wgsl"
    own = (folder / f"{shader}.wgsl").read_text(encoding="utf-8")
    if shader not in WITH_COMMON:
        return own
    before = ("common", "exact") if shader == "project" else ("common",)
    return "".join((folder / f"{name}.wgsl").read_text(encoding="utf-8") for name in before) + own


def _info(handle: Handle) -> AdapterInfo:
    info, limits = handle.info, handle.limits
    return AdapterInfo(
        name=str(info["device"]),
        driver=str(info["description"]),
        backend=str(info["backend_type"]),
        software=info["adapter_type"] == "CPU",
        timestamps="timestamp-query" in handle.features,
        max_binding_bytes=int(limits["max-storage-buffer-binding-size"]),
        max_buffer_bytes=int(limits["max-buffer-size"]),
    )


def _tells_of_loss(error: Exception) -> bool:
    text = str(error).lower()
    return isinstance(error, MemoryError) or "is lost" in text or "device lost" in text or "not enough memory" in text


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return "; ".join(lines[:1] + lines[-1:] if len(lines) > 1 else lines) or type(error).__name__
