import base64

import numpy as np
import pytest

import dynahull
from dynahull.labels import Label
from dynahull.parameters import MethodParameters
from pipeline.outputs import map_sample as sample_module
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.run_report import ClusterReport
from pipeline.places import DecisionSums
from pipeline.report_page.encoding import NEVER_CODE, PERCENT_CODES, encode
from pipeline.report_page.percentages import NEVER, confidence_percentages, removal_percentages


def cleaned(points, removal):
    parameters = {"removal": removal, "ground": {"method": "none"}, "neighbours": {"k": 20}}
    result = dynahull.clean(points, MethodParameters.of(parameters))
    columns = (result.labels, result.cluster, result.density, result.score)
    sample = MapSample.of_map(points, *columns)
    clusters = [ClusterReport.of(cluster) for cluster in result.clusters]
    section = MethodParameters.of(parameters).removal.model_dump()
    return result, sample, clusters, section


@pytest.fixture(scope="module")
def room():
    rng = np.random.default_rng(3)
    return np.concatenate(
        [rng.normal(place, 1 + place, (400 + 900 * place, 3)) for place in range(4)]
    )


@pytest.fixture
def small_samples(monkeypatch):
    monkeypatch.setattr(sample_module, "MOST_POINTS", 2_000)


@pytest.mark.parametrize("threshold", ["rank", "stepped"])
def test_at_the_runs_own_setting_just_what_the_run_removed_goes(room, threshold):
    removal = {"min_percent": 4, "max_percent": 17, "threshold": threshold}
    result, sample, clusters, section = cleaned(room, removal)
    percentages = removal_percentages(sample, clusters, section)
    gone = percentages.removed_from <= percentages.own
    assert (gone == (sample.labels == Label.DYNAMIC)).all()
    assert percentages.removed_points[170] == pytest.approx(result.counts()["dynamic"], abs=5)


@pytest.mark.parametrize("other", [3.0, 12.0, 40.0, 100.0])
def test_other_settings_take_what_a_run_with_them_takes(room, other):
    _, sample, clusters, section = cleaned(room, {"min_percent": 5, "max_percent": 20})
    percentages = removal_percentages(sample, clusters, section)
    again, *_ = cleaned(room, {"min_percent": other / 4, "max_percent": other})
    gone = percentages.removed_from <= other
    dynamic = again.labels == Label.DYNAMIC
    assert percentages.removed_points[round(10 * other)] == pytest.approx(dynamic.sum(), abs=5)
    # All points are in the sample: only one a cluster may be rounded the other way.
    assert (gone != dynamic).sum() <= len(clusters)


def test_a_sample_is_right_within_the_margin_it_states(room, small_samples):
    result, sample, clusters, section = cleaned(room, {"min_percent": 5, "max_percent": 20})
    assert 1_500 < len(sample) <= 2_000
    percentages = removal_percentages(sample, clusters, section)
    assert 0 < percentages.margin < 5
    shown = np.count_nonzero(percentages.removed_from <= percentages.own) / len(sample)
    assert shown == pytest.approx(result.counts()["dynamic"] / len(room), abs=0.03)
    again, *_ = cleaned(room, {"min_percent": 10, "max_percent": 40})
    for cluster in clusters:
        members = sample.cluster == cluster.index
        estimated = (percentages.removed_from[members] <= 40).mean()
        true = (again.labels[again.cluster == cluster.index] == Label.DYNAMIC).mean()
        assert estimated == pytest.approx(true, abs=2 * percentages.margin / 100)
        below = again.density[again.cluster == cluster.index] <= percentages.cuts[cluster.index][40]
        assert below.mean() == pytest.approx(true, abs=2 * percentages.margin / 100)


def test_points_that_have_no_volume_never_go(room):
    flat = np.concatenate([room, np.column_stack([np.arange(900) % 30, np.arange(900) // 30] * 2)
                           [:, [0, 1, 1]] * [1.0, 1.0, 0.0] + [500.0, 0.0, 0.0]])  # fmt: skip
    _, sample, clusters, section = cleaned(flat, {"min_percent": 5, "max_percent": 20})
    percentages = removal_percentages(sample, clusters, section)
    infinite = np.isposinf(sample.density)
    assert infinite.sum() >= 900
    assert (percentages.removed_from[infinite] == NEVER).all()
    assert percentages.removed_points[-1] <= len(flat) - infinite.sum()
    again, *_ = cleaned(flat, {"min_percent": 25, "max_percent": 100})
    assert percentages.removed_points[-1] == pytest.approx(again.counts()["dynamic"], abs=5)


def test_without_removal_there_is_no_ratio_to_keep(room):
    _, sample, clusters, section = cleaned(room, {"min_percent": 0, "max_percent": 0})
    percentages = removal_percentages(sample, clusters, section)
    assert percentages.removed_points[0] == 0
    assert percentages.removed_points[500] == pytest.approx(len(room) / 2, abs=5)
    assert (percentages.removed_from > 0).all()


def test_rounding_never_moves_a_point_across_the_runs_own_setting(room):
    _, sample, clusters, section = cleaned(room, {"min_percent": 5, "max_percent": 17.123})
    percentages = removal_percentages(sample, clusters, section)
    encoded = encode(sample, percentages)
    codes = np.frombuffer(base64.b64decode(encoded.arrays["percentages"]), "<u2")
    assert len(codes) == len(room)
    own = encoded.facts["own_code"]
    assert ((codes <= own) == (sample.labels == Label.DYNAMIC)).all()
    known = codes != NEVER_CODE
    off = codes[known] / PERCENT_CODES - percentages.removed_from[known]
    # Half a code for the percentage, half for the run's own, and one to lie on its right side.
    assert np.abs(off).max() <= 2 / PERCENT_CODES
    places = np.frombuffer(base64.b64decode(encoded.arrays["places"]), "<u2").reshape(-1, 3)
    low, span = np.array(encoded.facts["low"]), np.array(encoded.facts["span"])
    assert np.abs(low + places / 65_535 * span - sample.xyz).max() <= span.max() / 65_535


@pytest.mark.parametrize("confidence", [0.3, 0.505, 0.8])
def test_other_confidences_take_what_a_run_with_them_takes(room, confidence):
    removal = {"decision": "auto", "confidence": confidence}
    result, sample, clusters, _ = cleaned(room, removal)
    decision = DecisionSums.of(room, result.score, result.reason, confidence).decision()
    percentages = confidence_percentages(sample, clusters, confidence, decision)
    assert ((percentages.removed_from <= percentages.own) == (result.labels == Label.DYNAMIC)).all()
    facts = encode(sample, percentages)
    codes = np.frombuffer(base64.b64decode(facts.arrays["percentages"]), "<u2")
    own = facts.facts["own_code"]
    assert ((codes <= own) == (result.labels == Label.DYNAMIC)).all()
    for other in (5, 37, 95):
        again, *_ = cleaned(room, {"decision": "auto", "confidence": other / 100})
        place = round((100 - other) / percentages.step)
        gone = again.labels == Label.DYNAMIC
        assert percentages.removed_points[place] == gone.sum()
        shown = codes <= (100 - other) * PERCENT_CODES
        # Half a code at either side of the cut is all that can be off.
        off = np.abs(result.score[shown != gone] - other / 100)
        assert (off <= 2 / PERCENT_CODES / 100).all()
    assert percentages.removed_points[-1] == len(room)


def test_a_point_far_away_does_not_shrink_the_map(room):
    far = np.concatenate([room, [[1e6, 0.0, 0.0]]])
    _, sample, clusters, section = cleaned(far, {"min_percent": 5, "max_percent": 20})
    facts = encode(sample, removal_percentages(sample, clusters, section)).facts
    assert facts["outside"] == 1
    assert max(facts["span"]) < 100
