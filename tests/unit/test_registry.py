"""Names to methods: ours, outside ones, unknown ones, broken ones, and names that two packages claim."""

from importlib.metadata import EntryPoint

import pytest

import registration
from registration import registry
from registration.errors import BrokenMethodError, DuplicateMethodError, UnknownMethodError
from registration.methods.icp import PointToPointICP


def announce(monkeypatch, **points):
    found = [EntryPoint(name, value, registry.ENTRY_POINT_GROUP) for name, value in points.items()]
    monkeypatch.setattr(registry, "entry_points", lambda group: found)


def test_settings_reach_the_method():
    assert registration.create("icp", max_distance=0.5) == PointToPointICP(max_distance=0.5)


def test_an_instance_is_passed_through_but_takes_no_settings():
    method = PointToPointICP()
    assert registration.create(method) is method
    with pytest.raises(TypeError, match=r"settings \['max_distance'\] go with a method's name"):
        registration.create(method, max_distance=0.5)


def test_an_unknown_setting_is_refused():
    with pytest.raises(TypeError, match="max_distanse"):
        registration.create("icp", max_distanse=0.5)


@pytest.mark.parametrize(("setting", "value"), [("max_distance", 0.0), ("max_iterations", 0)])
def test_settings_that_cannot_work_are_refused(setting, value):
    with pytest.raises(ValueError, match=setting):
        registration.create("icp", **{setting: value})


def test_an_unknown_name_lists_what_there_is_and_the_nearest():
    with pytest.raises(
        UnknownMethodError, match=r"no registration method 'ipc'. Did you mean 'icp'\? Available: .*icp"
    ):
        registration.create("ipc")


def test_an_outside_method_is_found_by_name(monkeypatch):
    announce(monkeypatch, mine="registration.methods.icp:PointToPointICP")
    assert "mine" in registration.names()
    assert isinstance(registration.create("mine"), PointToPointICP)


def test_a_broken_plug_in_stays_listed_and_harms_nobody_else(monkeypatch):
    announce(monkeypatch, broken="no_such_package.mine:Mine")
    assert "broken" in registration.names()
    assert registration.create("icp").name == "icp"
    with pytest.raises(BrokenMethodError, match=r"method 'broken' of .* cannot be imported: .*no_such_package"):
        registration.create("broken")


def test_a_name_that_two_packages_claim_names_both(monkeypatch):
    points = [
        EntryPoint("mine", "one.place:Mine", registry.ENTRY_POINT_GROUP),
        EntryPoint("mine", "other.place:Mine", registry.ENTRY_POINT_GROUP),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    with pytest.raises(DuplicateMethodError, match=r"one.place:Mine.* and by .*other.place:Mine"):
        registration.create("mine")


def test_nobody_may_take_one_of_our_names(monkeypatch):
    announce(monkeypatch, icp="thief.place:Mine")
    with pytest.raises(DuplicateMethodError, match="regmot's own, and claimed by .*thief.place:Mine"):
        registration.create("icp")


def test_a_plug_in_that_breaks_in_its_own_way_is_still_just_broken(monkeypatch, tmp_path):
    (tmp_path / "stormy.py").write_text("raise RuntimeError('CUDA driver not found')\n")
    monkeypatch.syspath_prepend(tmp_path)
    announce(monkeypatch, stormy="stormy:Mine")
    with pytest.raises(BrokenMethodError, match="cannot be imported: CUDA driver not found"):
        registration.create("stormy")


def test_a_seed_reaches_the_methods_that_have_one_and_the_parts_of_compositions():
    seeded = registry.with_seed(registration.create("fgr+icp"), 7)
    assert seeded.first.seed == 7
    assert seeded.second == registration.create("icp")
    assert registry.with_seed(registration.create("icp"), 7) == registration.create("icp")
