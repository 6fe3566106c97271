"""Cluster trees: a forest of binary trees of limited depth over k-means leaves, with codes by position."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F32, F64


@dataclass(frozen=True, eq=False)
class Leaf:
    """One k-means cluster."""

    index: int

    def leaves(self) -> list[int]:
        """Indices of the leaves below, in order."""
        return [self.index]


@dataclass(frozen=True, eq=False)
class Fork:
    """Two merged clusters; ``first`` gets bit 0."""

    first: Node
    second: Node

    def leaves(self) -> list[int]:
        """Indices of the leaves below, in order."""
        out: list[int] = []
        stack: list[Node] = [self]
        while stack:  # no recursion: a chain of merges may be as deep as the number of leaves
            node = stack.pop()
            if isinstance(node, Leaf):
                out.append(node.index)
            else:
                stack += [node.second, node.first]
        return out


Node = Leaf | Fork


@dataclass(frozen=True, eq=False)
class CodedTree:
    """Codes of the leaves, and the values of all prefixes."""

    codes: np.ndarray  # [leaves] uint32, full length
    tables: tuple[F32, ...]  # one per layer, see cags_common.tiles.svq.Codebook


def code_length(roots: list[Node], base_bits: int, wished: int) -> int:
    """Number of code bits: enough for the deepest tree, but at most ``wished`` unless there are too many leaves."""
    deepest = max(_height(root) for root in roots)
    widest = max(len(root.leaves()) for root in roots)
    return base_bits + max(min(deepest, wished - base_bits), (widest - 1).bit_length())


def _height(root: Node) -> int:
    """Longest path down from ``root``, in forks."""
    stack: list[tuple[Node, int]] = [(root, 0)]
    height = 0
    while stack:
        node, depth = stack.pop()
        height = max(height, depth)
        if isinstance(node, Fork):
            stack += [(node.first, depth + 1), (node.second, depth + 1)]
    return height


def assign_codes(roots: list[Node], centres: F64, weights: F64, layer_bits: tuple[int, ...]) -> CodedTree:
    """Assign every leaf a code of ``sum(layer_bits)`` bits by its position in the forest, and every prefix a value.

    ``centres`` [leaves, dim] and ``weights`` [leaves] (numbers of samples) belong to the leaves. The value of an inner
    node is the mean of the samples below it. A node whose subtree is too deep for the remaining bits is cut in the
    middle of its leaves, which keeps similar leaves together. Leaves that end early are repeated at the levels below.
    Codes that nothing has stand for the mean of all.
    """
    total, everything = sum(layer_bits), _mean(centres, weights, list(range(len(weights))))
    codes = np.zeros(len(weights), np.uint32)
    depths = [0, *np.cumsum(layer_bits).tolist()]
    levels = {depth: np.tile(everything, (1 << depth, 1)) for depth in depths[1:]}
    for base, root in enumerate(roots):
        for prefix, depth, below in _walk(root, base, layer_bits[0], total):
            if len(below) == 1:
                codes[below[0]] = prefix << (total - depth)
            _fill(levels, prefix, depth, _mean(centres, weights, below), ends=len(below) == 1)
    return CodedTree(codes, tuple(level.astype(np.float32) for level in levels.values()))


def _walk(root: Node, base: int, base_bits: int, total: int) -> Iterator[tuple[int, int, list[int]]]:
    """Prefix, its length and the leaves below, for every node from the root down."""
    stack: list[tuple[Node | list[int], int, int]] = [(root, base, base_bits)]
    while stack:
        node, prefix, depth = stack.pop()
        below = node if isinstance(node, list) else node.leaves()
        yield prefix, depth, below
        if len(below) == 1:
            continue
        parts: tuple[Node | list[int], Node | list[int]]
        room = 1 << (total - depth - 1)
        if isinstance(node, Fork) and max(len(node.first.leaves()), len(node.second.leaves())) <= room:
            parts = node.first, node.second
        else:
            half = (len(below) + 1) // 2
            parts = below[:half], below[half:]
        stack += [(part, 2 * prefix + bit, depth + 1) for bit, part in enumerate(parts)]


def _mean(centres: F64, weights: F64, rows: list[int]) -> F64:
    weight = weights[rows]
    value: F64 = (centres[rows] * weight[:, None]).sum(axis=0) / weight.sum()
    return value


def _fill(levels: dict[int, F64], prefix: int, depth: int, value: F64, *, ends: bool) -> None:
    for level, table in levels.items():
        if level == depth or (ends and level > depth):
            spread = level - depth
            table[prefix << spread : (prefix + 1) << spread] = value
