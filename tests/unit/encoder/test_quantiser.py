import itertools

import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_common.geometry import rotation_matrix
from cags_common.splats import Splats
from cags_common.tiles.attributes import join_attributes, split_attributes
from cags_common.tiles.svq import CodebookSet
from cags_encoder.quantiser.canonical import canonical
from cags_encoder.quantiser.configs import quantiser_config
from cags_encoder.quantiser.kmeans import NearestCentre, kmeans
from cags_encoder.quantiser.merging import merge_as_printed
from cags_encoder.quantiser.splitting import split_tree
from cags_encoder.quantiser.training import train
from cags_encoder.quantiser.tree import Fork, Leaf, Node, assign_codes, code_length
from support.codec_scenes import cloud, with_changes

RANDOM = np.random.default_rng(0)


def chain(n: int) -> Node:
    node: Node = Leaf(0)
    for i in range(1, n):
        node = Fork(node, Leaf(i))
    return node


def test_codes_follow_the_tree_and_prefixes_are_weighted_means() -> None:
    roots: list[Node] = [Fork(Leaf(0), Leaf(1)), Leaf(2)]
    centres, weights = np.array([[0.0], [3.0], [10.0]]), np.array([2.0, 1.0, 5.0])
    coded = assign_codes(roots, centres, weights, (1, 1))
    assert coded.codes.tolist() == [0b00, 0b01, 0b10]
    assert coded.tables[0][:, 0].tolist() == [1.0, 10.0]
    assert coded.tables[1][:, 0].tolist() == [0.0, 3.0, 10.0, 10.0], "a leaf that ends early is repeated"


@pytest.mark.parametrize("leaves", [2, 5, 64, 300])
def test_a_chain_deeper_than_the_code_is_cut_and_every_leaf_keeps_its_own_code(leaves: int) -> None:
    roots = [chain(leaves)]
    length = code_length(roots, 4, 12)
    assert length == 4 + max(min(leaves - 1, 8), (leaves - 1).bit_length())
    centres = np.arange(leaves, dtype=np.float64)[:, None]
    coded = assign_codes(roots, centres, np.ones(leaves), (4, *[1] * (length - 4)))
    assert len(np.unique(coded.codes)) == leaves
    assert np.array_equal(coded.tables[-1][coded.codes], centres.astype(np.float32))


def test_merging_joins_what_belongs_together() -> None:
    centres = np.array([[0.0], [0.1], [5.0], [5.2], [9.0]], np.float32)
    labels = np.repeat(np.arange(5), 10)
    points = centres[labels] + RANDOM.normal(size=(50, 1)).astype(np.float32) * 0.01
    trees = merge_as_printed(points, labels, centres, 3)
    assert sorted(sorted(tree.leaves()) for tree in trees) == [[0, 1], [2, 3], [4]]


def test_kmeans_with_few_distinct_points_returns_them() -> None:
    points = np.repeat(np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), 500, axis=0)
    assert kmeans(points, 16, 0).tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize("dim", [1, 3, 9])
def test_nearest_centre_agrees_with_comparing_all(dim: int) -> None:
    centres, points = (
        RANDOM.normal(size=(40, dim)).astype(np.float32),
        RANDOM.normal(size=(500, dim)).astype(np.float32),
    )
    expected = np.linalg.norm(points[:, None] - centres[None], axis=2).argmin(axis=1)
    assert np.array_equal(NearestCentre(centres)(points), expected)


@pytest.fixture(scope="module")
def paper_66() -> tuple[Splats, CodebookSet]:
    """Splats of every attribute, and the paper's quantiser trained on them."""
    splats = cloud(4000, 0, 3)
    return splats, train(splats, quantiser_config("paper-66"), 0)


def test_paper_66_spends_66_bits_and_has_16_base_clusters(paper_66: tuple[Splats, CodebookSet]) -> None:
    config = quantiser_config("paper-66")
    assert sum(a.tree_bits for a in config.attributes) == 66
    assert sum(a.tree_bits for a in quantiser_config("paper-76").attributes) == 76
    _, quantiser = paper_66
    assert {book.layer_bits[0] for book in quantiser.books} == {4}
    assert all(bits <= 2 for book in quantiser.books for bits in book.layer_bits[1:])
    with pytest.raises(ConfigError, match="known: layered, paper-66"):
        quantiser_config("paper-6")


def test_more_layers_are_nearer(paper_66: tuple[Splats, CodebookSet]) -> None:
    splats, quantiser = paper_66
    codes, values = quantiser.encode(splats), split_attributes(splats)
    for book in quantiser.books:
        name = book.attribute
        errors = [
            float(np.square(book.lookup(book.prefix(codes[name], depth), depth) - values[name]).mean())
            for depth in (1, len(book.layer_bits))
        ]
        assert errors[1] < errors[0], name


def constant(n: int) -> dict[str, np.ndarray]:
    return {
        "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        "log_scales": np.full((n, 3), -3, np.float32),
        "logit_opacities": np.full(n, 2, np.float32),
        "sh0": np.zeros((n, 3), np.float32),
    }


@pytest.mark.parametrize("n", [1, 2, 15, 17, 300])
def test_constant_attributes_and_few_splats_are_exact(n: int) -> None:
    for splats in (cloud(n), with_changes(cloud(n), **constant(n))):
        quantiser = train(splats, quantiser_config("paper-66"), 0)
        decoded = quantiser.decode(quantiser.encode(splats))
        if n <= 17:
            values = split_attributes(splats)
            for name, value in decoded.items():
                assert np.allclose(value, values[name], atol=2e-4), name  # entries have 15 bits
    assert all(book.layer_bits == (4,) for book in quantiser.books), "one value needs no enhancement layer"


def test_extreme_scales_and_opacities_stay_finite() -> None:
    splats = cloud(300)
    scales, logits = splats.log_scales.copy(), splats.logit_opacities.copy()
    scales[:5], scales[5:9], logits[:5], logits[5:9] = -200, 60, -80, 80
    splats = with_changes(splats, log_scales=scales, logit_opacities=logits)
    quantiser = train(splats, quantiser_config("paper-66"), 0)
    assert all(np.isfinite(values).all() for values in quantiser.decode(quantiser.encode(splats)).values())


def test_canonical_axes_describe_the_same_gaussians() -> None:
    splats = cloud(500).checked("x")
    same = canonical(splats)
    assert (np.diff(same.log_scales, axis=1) <= 0).all()
    assert (same.quats[:, 0] >= 0.4999).all(), "a turn of at most 120 degrees is left"
    assert np.allclose(np.linalg.norm(same.quats, axis=1), 1, atol=1e-6)
    assert np.allclose(covariances(splats), covariances(same), atol=1e-9)


def covariances(splats: Splats) -> np.ndarray:
    turns = np.stack([rotation_matrix(tuple(map(float, q))) for q in splats.quats])
    half = turns * np.exp(splats.log_scales.astype(np.float64))[:, None, :]
    return half @ half.transpose(0, 2, 1)


def test_q_and_minus_q_and_turns_by_180_degrees_give_the_same_codes() -> None:
    splats = cloud(500).checked("x")
    turned = splats.quats.copy()
    turned[:4] = [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0]]
    splats = with_changes(splats, quats=turned)
    quantiser = train(splats, quantiser_config("layered"), 0)
    codes = quantiser.encode(quantiser.prepare(splats))
    other = quantiser.encode(quantiser.prepare(with_changes(splats, quats=-splats.quats)))
    assert all(np.array_equal(codes[name], other[name]) for name in codes)


@pytest.mark.parametrize("n", [1, 2, 15, 300])
def test_layered_codebooks_of_few_or_constant_splats(n: int) -> None:
    for splats in (cloud(n), with_changes(cloud(n), **constant(n))):
        quantiser = train(splats, quantiser_config("layered"), 0)
        prepared = quantiser.prepare(splats.checked("x"))
        decoded = split_attributes(join_attributes(prepared.means, quantiser.decode(quantiser.encode(prepared))))
        values = split_attributes(prepared)
        bounds = {"scale": 0.01, "rotation": 0.01, "alpha": 0.02, "sh0": 0.01}
        assert all(np.allclose(decoded[name], values[name], atol=bound) for name, bound in bounds.items())
        assert CodebookSet.from_bytes(quantiser.books.to_bytes()).to_bytes() == quantiser.books.to_bytes()
    assert all(book.layer_bits == (4,) for book in quantiser.books)


def test_saturated_opacities_leave_the_clusters_to_the_others() -> None:
    splats = cloud(400)
    between = np.linspace(-3, 3, 400, dtype=np.float32)
    saturated = np.where(np.arange(400) % 2, np.float32(20), between)
    codes = {}
    for name, logits in (("at the limit", np.where(saturated == 20, np.float32(5), between)), ("beyond it", saturated)):
        changed = with_changes(splats, logit_opacities=logits)
        quantiser = train(changed, quantiser_config("layered"), 0)
        codes[name] = quantiser.encode(quantiser.prepare(changed))["opacity"]
        drawn = split_attributes(join_attributes(changed.means, quantiser.decode(quantiser.encode(changed))))["alpha"]
        assert np.abs(drawn - split_attributes(changed)["alpha"]).max() < 0.02
    assert np.array_equal(codes["at the limit"], codes["beyond it"])


def test_the_second_tree_refines_the_leaves_of_the_first() -> None:
    splats = cloud(6000, 2)
    quantiser = train(splats, quantiser_config("layered"), 0)
    prepared = quantiser.prepare(splats.checked("x"))
    codes, values = quantiser.encode(prepared), split_attributes(prepared)
    for name in ("scale", "rotation", "sh0"):
        book = quantiser.books[name]
        layers = range(1, len(book.layer_bits) + 1)
        errors = [float(np.square(book.lookup(book.prefix(codes[name], k), k) - values[name]).mean()) for k in layers]
        assert all(a > b for a, b in itertools.pairwise(errors)), name
        assert errors[-1] < errors[0] / 100


def test_split_trees_are_complete_and_each_level_is_nearer() -> None:
    points = RANDOM.normal(size=(5000, 3))
    means, cells = split_tree(points, np.ones(5000), 6)
    assert [len(level) for level in means] == [1, 2, 4, 8, 16, 32, 64]
    errors = [np.square(points - level[cells >> (6 - depth)]).mean() for depth, level in enumerate(means)]
    assert all(a > b for a, b in itertools.pairwise(errors))
    assert np.bincount(cells, minlength=64).min() > 0
