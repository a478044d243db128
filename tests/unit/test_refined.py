"""Compositions: the second method starts from the first one's answer, and the status tells the truth."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

import registration
from registration import registry
from registration.errors import UnknownMethodError
from registration.method import PairMethod
from registration.methods.icp import PointToPointICP
from registration.refined import Refined
from registration.types import RegistrationResult, Status
from tests.segments import car_cloud


@dataclass(frozen=True)
class Scripted(PairMethod):
    """Answer a stated motion with a stated status, and remember the priors."""

    name: ClassVar[str] = "scripted"
    x: float = 0.0
    status: Status = Status.CONVERGED
    priors: tuple = ()

    def prepare_cloud(self, points):
        return points

    def align_pair(self, source, target, prior):
        self.priors[0].append(prior)
        T = np.eye(4)
        T[0, 3] = self.x
        center = source.mean(axis=0) if len(source) else np.zeros(3)
        return RegistrationResult(T, center, np.diag([0.04, 0.09, 0.01]), self.status, float("nan"), 0)


def scripted(**answer):
    return Scripted(priors=([],), **answer)


def test_the_second_starts_from_the_motion_and_covariance_of_the_first():
    first, second = scripted(x=0.7), scripted(x=0.8)
    result = registration.refined(first, second).register(car_cloud(20), car_cloud(20))
    (prior,) = second.priors[0]
    np.testing.assert_allclose(prior.mean, [0.7, 0.0, 0.0])
    np.testing.assert_allclose(prior.covariance, np.diag([0.04, 0.09, 0.01]))
    assert result.T_target_source[0, 3] == 0.8
    assert first.priors[0] == [None]


@pytest.mark.parametrize("lost", [Status.NO_OVERLAP, Status.TOO_FEW_POINTS])
def test_where_the_second_finds_nothing_the_firsts_answer_stands_and_the_status_says_so(lost):
    result = registration.refined(scripted(x=0.7), scripted(x=9.0, status=lost)).register(
        np.ones((9, 3)), np.ones((9, 3))
    )
    assert result.T_target_source[0, 3] == 0.7
    assert result.status is lost


def test_an_abstention_of_the_first_is_refined_from_its_fallback():
    first = scripted(x=0.3, status=Status.NO_OVERLAP)
    source = car_cloud(300)
    result = registration.refined(first, by="icp").register(source, source + [0.35, 0.0, 0.0])
    assert result.status is Status.CONVERGED
    np.testing.assert_allclose(result.T_target_source[:2, 3], [0.35, 0.0], atol=1e-3)


def test_icp_after_the_centroids_is_icp():
    source, target = car_cloud(300) + [12.0, 5.0, 0.0], car_cloud(300, 1) + [12.3, 5.1, 0.0]
    composed, alone = (registration.create(name).register(source, target) for name in ("centroid+icp", "icp"))
    np.testing.assert_allclose(composed.T_target_source, alone.T_target_source, atol=1e-9)


def test_a_composition_keeps_the_contract():
    registration.check_method(registration.create("centroid+icp"))
    registration.check_method(registration.refined("icp", by="centroid"))


def test_batches_and_priors_reach_the_first():
    first = scripted()
    method = registration.refined(first, "centroid")
    a, b = method.prepare([car_cloud(20), car_cloud(20)])
    prior = registration.MotionPrior(np.zeros(3), np.eye(3))
    assert len(method.align([(a, b), (b, a)], [prior, None])) == 2
    assert first.priors[0] == [prior, None]
    with pytest.raises(ValueError, match="2 pairs but 1 priors"):
        method.align([(a, b), (b, a)], [prior])


def test_names_make_compositions_of_any_length():
    method = registration.create("centroid+icp+icp")
    assert method.name == "centroid+icp+icp"
    assert isinstance(method, Refined)
    assert isinstance(method.second, PointToPointICP)


def test_settings_go_by_the_names_of_the_parts():
    method = registration.create("centroid+icp", icp={"max_distance": 0.3})
    assert method.second.max_distance == 0.3
    with pytest.raises(TypeError, match=r"dictionaries by the names of its parts.*got max_distance=0.3"):
        registration.create("centroid+icp", max_distance=0.3)
    with pytest.raises(TypeError, match="max_distanse"):
        registration.create("centroid+icp", icp={"max_distanse": 0.3})


@pytest.mark.parametrize("name", ["centroid+ipc", "ipc+icp", "icp+", "+icp"])
def test_an_unknown_part_is_named(name):
    with pytest.raises(UnknownMethodError, match="no registration method"):
        registration.create(name)
    assert not registry.is_known(name)


def test_listed_compositions_are_known_and_ours():
    assert {"fgr+icp", "global-icp+icp"} <= set(registration.names())
    assert registry.is_known("centroid+icp")
    assert registry.source_of("centroid+icp") == "regmot"


def test_an_outside_name_with_a_plus_is_left_whole(monkeypatch):
    from importlib.metadata import EntryPoint

    point = EntryPoint("my+own", "registration.methods.icp:PointToPointICP", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    assert registration.create("my+own", max_distance=0.2) == PointToPointICP(max_distance=0.2)


def test_results_are_not_shared():
    method = registration.refined(scripted(x=0.7), scripted(status=Status.NO_OVERLAP))
    result = method.register(np.ones((5, 3)), np.ones((5, 3)))
    assert replace(result, status=Status.CONVERGED).status is Status.CONVERGED
