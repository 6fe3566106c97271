"""Host and shaders agree: structs byte by byte, bindings one by one; and the shaders stay within WebGPU's defaults."""

from __future__ import annotations

import re
from importlib import resources

import pytest

from cags_gpu.device import STORAGE_BUFFERS, WORKGROUP_BYTES, source
from cags_gpu.graph import buffer_bytes, graph
from cags_gpu.layout import LAYOUTS

SHADERS = sorted(
    path.name.removesuffix(".wgsl")
    for path in (resources.files("cags_gpu") / "wgsl").iterdir()
    if path.name.endswith(".wgsl") and path.name not in ("common.wgsl", "exact.wgsl")
)
TYPES = {
    "f32": (4, 4, "f", 1),
    "u32": (4, 4, "I", 1),
    "vec2<f32>": (8, 8, "f", 2),
    "vec2<u32>": (8, 8, "I", 2),
    "vec4<f32>": (16, 16, "f", 4),
    "vec4<u32>": (16, 16, "I", 4),
}
"""Alignment, size, format and number of scalars (WGSL specification, "Alignment and size")."""

RADIX = {
    "count": ["job", "state", "keys_in", None, None, None, "histogram"],
    "scan": ["job", "state", None, None, None, None, "histogram"],
    "scatter": ["job", "state", "keys_in", "values_in", "keys_out", "values_out", "histogram"],
}


def structs() -> dict[str, dict[str, tuple[int, str, int]]]:
    """Uniform structs of all shaders: field -> offset, format, number."""
    found = {}
    for shader in SHADERS:
        text = re.sub(r"//[^\n]*", "", source(shader))
        for name, body in re.findall(r"struct (\w+) \{([^}]*)\}", text):
            if name not in LAYOUTS:
                continue
            at, fields = 0, {}
            for field, kind in re.findall(r"(\w+): ([\w<>]+)", body):
                alignment, size, code, number = TYPES[kind]
                at = -(-at // alignment) * alignment
                fields[field] = (at, code, number)
                at += size
            found[name] = fields
            assert -(-at // 16) * 16 == LAYOUTS[name].size, name
    return found


def bindings(shader: str) -> dict[int, tuple[str, str]]:
    """Binding -> name and access, as the shader declares them."""
    pattern = r"@binding\((\d+)\) var<(uniform|storage, read|storage, read_write)> (\w+)"
    accesses = {"uniform": "uniform", "storage, read": "read", "storage, read_write": "write"}
    return {int(i): (name, accesses[kind]) for i, kind, name in re.findall(pattern, source(shader))}


def functions(shader: str) -> dict[str, str]:
    """Bodies of a shader's functions."""
    text = re.sub(r"//[^\n]*", "", source(shader))
    parts = re.split(r"\bfn (\w+)", text)
    return {name: braced(part) for name, part in zip(parts[1::2], parts[2::2], strict=True)}


def braced(text: str) -> str:
    """``text`` up to where its first brace closes."""
    depth, begun = 0, False
    for at, letter in enumerate(text):
        depth += (letter == "{") - (letter == "}")
        begun = begun or letter == "{"
        if begun and not depth:
            return text[:at]
    raise AssertionError("braces do not close")


def used(shader: str, entry: str) -> set[int]:
    """Bindings that an entry point uses, through what it calls."""
    bodies, seen, todo = functions(shader), set(), [entry]
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += [other for other in bodies if re.search(rf"\b{other}\(", bodies[name])]
    text = " ".join(bodies[name] for name in seen)
    return {i for i, (name, _) in bindings(shader).items() if re.search(rf"\b{name}\b", text)}


def passes() -> list[tuple[str, str, list[object]]]:
    steps = [step for steps in graph()["graphs"].values() for step in steps]
    return [(s["shader"], s["entry"], s["bind"]) for s in steps if "shader" in s]


def test_structs_are_packed_as_the_shaders_lay_them_out() -> None:
    assert structs() == {name: dict(layout.fields) for name, layout in LAYOUTS.items()}


@pytest.mark.parametrize(("shader", "entry", "bind"), passes(), ids=lambda v: v if isinstance(v, str) else "")
def test_a_pass_binds_what_its_entry_point_uses_with_the_declared_access(shader, entry, bind) -> None:
    declared = bindings(shader)
    bound = {i: pair[1] for i, pair in enumerate(bind) if pair}
    assert bound == {i: declared[i][1] for i in used(shader, entry)}


@pytest.mark.parametrize("entry", RADIX)
def test_the_sorts_bind_what_the_radix_passes_use(entry: str) -> None:
    names = {i for i, name in enumerate(RADIX[entry]) if name}
    assert names == used("radix", entry)
    assert [bindings("radix")[i][0] for i in sorted(names)] == [name for name in RADIX[entry] if name]


def test_every_entry_point_is_run() -> None:
    entries = {(s, e) for s in SHADERS for e in re.findall(r"@compute[^{]*?fn (\w+)", source(s))}
    assert entries == {(s, e) for s, e, _ in passes()} | {("radix", e) for e in RADIX}


@pytest.mark.parametrize(("shader", "entry", "bind"), passes(), ids=lambda v: v if isinstance(v, str) else "")
def test_no_pass_binds_more_storage_buffers_than_every_device_has(shader, entry, bind) -> None:
    assert sum(pair is not None and pair[1] != "uniform" for pair in bind) <= STORAGE_BUFFERS


@pytest.mark.parametrize("shader", SHADERS)
def test_shaders_use_nothing_that_some_device_lacks(shader: str) -> None:
    text = source(shader)
    assert "enable " not in text, "no f16, no subgroups in the core"
    assert "subgroup" not in text.replace("without subgroups", "")
    for x, y in re.findall(r"@workgroup_size\((\d+)(?:, (\d+))?\)", text):
        assert int(x) * int(y or 1) <= 256
    sizes = {"u32": 4, "f32": 4, "atomic<u32>": 4, "atomic<i32>": 4, "vec4<f32>": 16}
    constants = {name: int(value) for name, value in re.findall(r"const (\w+) = (\d+)u;", text)}
    arrays = re.findall(r"var<workgroup> \w+: array<([\w<>]+), (\w+)>", text)
    total = sum(sizes[kind] * (int(n) if n.isdigit() else constants[n]) for kind, n in arrays)
    singles = len(re.findall(r"var<workgroup> \w+: (?!array)", text))
    assert total + 4 * singles <= WORKGROUP_BYTES


def test_buffers_that_passes_name_are_declared() -> None:
    declared = {name for buffers in graph()["buffers"].values() for name in buffers}
    by_host = {"sh_rest", "staged", "own", "truth", "mirror", "small", "veto"}
    for _, _, bind in passes():
        for name, access in (pair for pair in bind if pair):
            assert access == "uniform" or name.startswith("@") or name in declared | by_host, name


def test_a_name_means_one_buffer_whoever_owns_it() -> None:
    """Hosts look a name up among the view's buffers, then among those that all share: two of one name are one."""
    names = [name for buffers in graph()["buffers"].values() for name in buffers]
    assert len(names) == len(set(names))


def test_sizes_follow_the_counts() -> None:
    sizes = buffer_bytes("work", {"splats": 5000, "exact_splats": 1, "capacity": 4096, "one": 1})
    assert sizes["records"] == 160_000
    assert sizes["colours"] == 16
    assert sizes["block_sums"] == 4 * 20
    assert sizes["entry_histogram"] == 2 * 1024 + 1024


@pytest.mark.parametrize("shader", SHADERS)
def test_no_remainder_of_signed_numbers_is_taken(shader: str) -> None:
    """Vulkan leaves that of negative ones undefined: an NVIDIA driver takes them for huge."""
    text = re.sub(r"//[^\n]*", "", source(shader))
    signed = {*re.findall(r"(\w+): (?:vec\d<)?i32", text), *re.findall(r"let (\w+) = (?:vec\d<)?i32[>(]", text)}
    taken = re.findall(r"([\w.)]+) % ([\w.(]+)", text)
    assert not [pair for pair in taken if {part.strip("().").split(".")[0] for part in pair} & signed]
    assert "%" not in re.sub(r"[\w.)]+ % [\w.(]+", "", text), "written so that the line above finds them"
