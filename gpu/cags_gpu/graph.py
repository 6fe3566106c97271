"""Runs the pass graph of ``graph.json``: buffers' sizes, bind groups, sorts, dispatches."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, TypeAlias

from cags_gpu.device import Gpu, Handle
from cags_gpu.layout import SORT

MAX_GROUPS = 65535
"""Workgroups along one axis of a dispatch (WebGPU)."""

RADIX_BITS = 8
BLOCK = 2048

Counts: TypeAlias = Mapping[str, int]
Resolve: TypeAlias = Callable[[str], Handle]
"""Gives the buffer of a name, or a part of one: a dictionary of ``buffer``, ``offset`` and ``size``."""


@dataclass(frozen=True, slots=True)
class Dispatch:
    """One dispatch, or (``pipeline`` None) a buffer that is set to zeros."""

    label: str
    pipeline: Handle
    group: Handle
    groups: tuple[int, int] = (1, 1)
    indirect: tuple[Handle, int] | None = None  # buffer and byte offset


@cache
def graph() -> dict[str, Any]:
    """``graph.json`` as it is."""
    text = (resources.files("cags_gpu") / "graph.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def buffer_bytes(owner: str, counts: Counts) -> dict[str, int]:
    """Sizes of the owner's buffers at ``counts``, as far as these name what a size depends on."""
    sizes = {}
    for name, rule in graph()["buffers"][owner].items():
        if rule["of"] in counts:
            units = -(-counts[rule["of"]] // rule.get("per", 1))
            sizes[name] = rule["bytes"] * units + rule.get("plus", 0)
    return sizes


def build(gpu: Gpu, name: str, counts: Counts, flags: Mapping[str, bool], resolve: Resolve) -> list[Dispatch]:
    """The dispatches of graph ``name``; ``flags`` choose steps (``when``) and give pipelines their constants."""
    steps: list[Dispatch] = []
    sorted_pairs: dict[str, str] = {}
    for step in graph()["graphs"][name]:
        if not all(_holds(condition, flags) for condition in step.get("when", ())):
            continue
        if "sort" in step:
            steps += _sort(gpu, step, counts, resolve, sorted_pairs)
        elif "clear" in step:
            steps.append(Dispatch(f"clear {step['clear']}", None, resolve(step["clear"])))
        else:
            bind = [pair and (sorted_pairs.get(pair[0], pair[0]), pair[1]) for pair in step["bind"]]
            constants = {key: flags[flag] for key, flag in step.get("constants", {}).items()}
            made = _dispatch(gpu, (step["shader"], step["entry"]), bind, constants, resolve)
            where = _groups(step, counts) if "groups" in step else (1, 1)
            indirect = (resolve("dispatch"), step["indirect"]) if "indirect" in step else None
            steps.append(Dispatch(made.label, made.pipeline, made.group, where, indirect))
    return steps


def _holds(condition: str, flags: Mapping[str, bool]) -> bool:
    return not flags[condition[1:]] if condition.startswith("!") else flags[condition]


def _groups(step: Mapping[str, Any], counts: Counts) -> tuple[int, int]:
    numbers = [-(-counts[name] // per) for name, per in step["groups"]]
    if len(numbers) == 2:
        return numbers[0], numbers[1]
    columns = min(numbers[0], MAX_GROUPS)
    return columns, -(-numbers[0] // columns) if columns else 0


def _dispatch(
    gpu: Gpu, point: tuple[str, str], bind: Iterable[Any], constants: Mapping[str, bool], resolve: Resolve
) -> Dispatch:
    """One run of an entry point (shader, name) over buffers."""
    (shader, entry), pairs = point, list(bind)
    accesses = [pair and pair[1] for pair in pairs]
    pipeline = gpu.pipeline(shader, entry, accesses, constants)
    entries = [
        {"binding": i, "resource": _resource(resolve(pair[0]) if isinstance(pair[0], str) else pair[0])}
        for i, pair in enumerate(pairs)
        if pair
    ]
    group = gpu.device.create_bind_group(layout=gpu.layout(accesses), entries=entries)
    return Dispatch(f"{shader}.{entry}", pipeline, group)


def _resource(found: Handle) -> Handle:
    return found if isinstance(found, dict) else {"buffer": found}


def _sort(
    gpu: Gpu, step: Mapping[str, Any], counts: Counts, resolve: Resolve, sorted_pairs: dict[str, str]
) -> list[Dispatch]:
    """Passes of a radix sort. Buffers are listed as the first pass's input, then the two that take turns."""
    bits = counts[step["bits"]] if isinstance(step["bits"], str) else step["bits"]
    count = counts[step["of"]]
    blocks = max(1, -(-count // BLOCK))
    indirect = (resolve("dispatch"), step["indirect"]) if "indirect" in step else None
    groups = _groups({"groups": [[step["of"], BLOCK]]}, counts)
    (keys, *key_turns), (values, *value_turns) = step["keys"], step["values"]
    steps = []
    for turn, shift in enumerate(range(0, bits, RADIX_BITS)):
        to = (turn + 1) % 2
        job = gpu.uniform(SORT.pack(shift=shift, count=count, blocks=blocks, counted=int(indirect is not None)))
        head: list[Any] = [(job, "uniform"), ("state", "read")]
        histogram = (step["histogram"], "write")
        output = [(key_turns[to], "write"), (value_turns[to], "write")]
        passes = {
            "count": ([*head, (keys, "read"), None, None, None, histogram], groups, indirect),
            "scan": ([*head, None, None, None, None, histogram], (1 << RADIX_BITS, 1), None),
            "scatter": ([*head, (keys, "read"), (values, "read"), *output, histogram], groups, indirect),
        }
        for entry, (bind, where, by) in passes.items():
            made = _dispatch(gpu, ("radix", entry), bind, {}, resolve)
            steps.append(Dispatch(f"radix.{entry} {step['sort']}", made.pipeline, made.group, where, by))
        keys, values = key_turns[to], value_turns[to]
    sorted_pairs[f"@{step['sort']}"], sorted_pairs[f"@{step['sort']}.keys"] = values, keys
    return steps


def encode(encoder: Handle, steps: Iterable[Dispatch]) -> None:
    """Record ``steps`` one after the other, as few passes as clearing allows."""
    running: Handle = None
    for step in steps:
        if step.pipeline is None:
            if running is not None:
                running.end()
                running = None
            encoder.clear_buffer(step.group)
            continue
        running = running if running is not None else encoder.begin_compute_pass()
        record(running, step)
    if running is not None:
        running.end()


def record(running: Handle, step: Dispatch) -> None:
    """Put one dispatch into a compute pass."""
    if step.indirect is None and 0 in step.groups:
        return
    running.set_pipeline(step.pipeline)
    running.set_bind_group(0, step.group)
    if step.indirect is not None:
        running.dispatch_workgroups_indirect(*step.indirect)
    else:
        running.dispatch_workgroups(*step.groups)
