"""`check_method` passes methods that keep the contract and says which promise the others break."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import registration
from registration.errors import MethodContractError
from registration.methods.icp import PointToPointICP
from registration.types import Status


@pytest.mark.parametrize("name", registration.names())
def test_every_registered_method_keeps_the_contract(name):
    registration.check_method(registration.create(name))


@dataclass(frozen=True)
class Overconfident(PointToPointICP):
    def align_pair(self, source, target, prior):
        return replace(super().align_pair(source, target, prior), covariance=np.zeros((3, 3)))


@dataclass(frozen=True)
class Tilting(PointToPointICP):
    def align_pair(self, source, target, prior):
        result = super().align_pair(source, target, prior)
        T = result.T_target_source.copy()
        T[:3, :3] = T[:3, :3] @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
        return replace(result, T_target_source=T)


@dataclass(frozen=True)
class Leaping(PointToPointICP):
    def align_pair(self, source, target, prior):
        result = super().align_pair(source, target, prior)
        T = result.T_target_source.copy()
        T[0, 3] += 1000.0 * (len(source.points) < 3)
        return replace(result, T_target_source=T)


@dataclass(frozen=True)
class Pretending(PointToPointICP):
    def align_pair(self, source, target, prior):
        return replace(super().align_pair(source, target, prior), status=Status.CONVERGED)


@dataclass(frozen=True)
class Deaf(PointToPointICP):
    def prepare(self, clouds):
        return [
            self.prepare_cloud(np.nan_to_num(np.resize(np.asarray(cloud, float), (len(cloud), 3)))) for cloud in clouds
        ]


@dataclass(frozen=True)
class Wrong(PointToPointICP):
    def align_pair(self, source, target, prior):
        return super().align_pair(target, source, prior)


@dataclass(frozen=True)
class Moody(PointToPointICP):
    def align(self, pairs, priors=None):
        results = super().align(pairs, priors)
        return [replace(r, covariance=r.covariance * len(results)) for r in results]


@dataclass(frozen=True)
class Meddling(PointToPointICP):
    def prepare(self, clouds):
        for cloud in clouds:
            if np.shape(cloud)[1:] == (3,) and np.isfinite(cloud).all():
                cloud *= 1.0001
        return super().prepare(clouds)


@pytest.mark.parametrize(
    ("method", "promise"),
    [
        (Overconfident(), "no shift is known exactly"),
        (Tilting(), "it turns about z only"),
        (Leaping(), "poor clouds cause no leap, got one of 1000 m"),
        (Pretending(), "an empty cloud is no success"),
        (Deaf(), "raises InvalidCloudError"),
        (Wrong(), "source_centroid is the mean of the source"),
        (Moody(), "pairs of a batch do not influence each other"),
        (Meddling(), "source_centroid|never changed|same result"),
    ],
)
def test_a_broken_promise_is_named(method, promise):
    with pytest.raises(MethodContractError, match=promise):
        registration.check_method(method)


def test_something_that_is_no_method_is_refused():
    with pytest.raises(MethodContractError, match="it has name, prepare, align and register"):
        registration.check_method(object())
