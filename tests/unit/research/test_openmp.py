"""What OpenMP's threads do while they wait is set before torch is loaded, and is the user's where the user says so."""

import os
import subprocess
import sys

import pytest

from cags_research.openmp import SPINS, yield_cores


def test_threads_give_their_cores_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    monkeypatch.delenv("GOMP_SPINCOUNT", raising=False)
    yield_cores()
    assert os.environ["GOMP_SPINCOUNT"] == SPINS


@pytest.mark.parametrize(("name", "value"), [("GOMP_SPINCOUNT", "7"), ("OMP_WAIT_POLICY", "active")])
def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    for other in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, value)
    yield_cores()
    assert os.environ[name] == value
    assert len(os.environ.keys() & {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"}) == 1


def test_it_is_settled_before_torch_comes() -> None:
    program = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "torch":
            print(os.environ.get("GOMP_SPINCOUNT"))
            raise SystemExit(0)
sys.meta_path.insert(0, Watch())
import cags_research.restore.networks.srresnet
"""
    bare = {k: v for k, v in os.environ.items() if k not in {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"}}
    done = subprocess.run([sys.executable, "-c", program], env=bare, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == SPINS
