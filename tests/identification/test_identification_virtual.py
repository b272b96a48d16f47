"""The whole chain on a campaign of the virtual turbine, whose true modes are known: two idling hours."""

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.checking import check
from probupdate.campaign.reading import read_campaign
from probupdate.identification.identify import identify
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.selection import select
from probupdate.modal.labels import close_pairs
from probupdate.modal.modes import plane_mac
from probupdate.virtual.simulation import simulate
from probupdate.virtual.truth import read_truth_modes

WANTED = ("FA1", "SS1", "T1", "FA2", "SS2")


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    """Two hours at a standstill and the true modes at their heading."""
    folder = tmp_path_factory.mktemp("virtual")
    given = folder / "given.toml"
    given.write_text('[operation]\nmaintenance_hours = [[0, 2]]\nmissing_hours = []\nwind_speed_mean_mps = 8.0\n')
    simulate(folder / "campaign", days=2 / 24, truth=given, seed=5)
    return folder / "campaign"


def reference_at_rest(truth) -> ReferenceModes:
    """A rough model: the turbine's modes with fore-aft along x, 20 % too low in the second pair."""
    index = [truth.labels.index(name) for name in WANTED]
    frequency = truth.frequency_hz[index] * [1.0, 1.0, 0.95, 0.8, 0.8]
    return ReferenceModes(labels=WANTED, frequency_hz=frequency, shape=truth.shape[:, index],
                          pairs=close_pairs(frequency, WANTED))


def test_an_idling_turbine_s_modes_are_found_and_selected(virtual, validation):
    row = validation(what="two idling hours of the virtual turbine: frequencies; planes of both pairs",
                     reference="its truth", why="five standard deviations of half an hour")
    truth = read_truth_modes(virtual / "truth.toml")
    campaign = read_campaign(virtual)
    found = check(campaign)
    assert not [f for f in found.findings if "flat" in f or "clipped" in f or "unit" in f]
    # the model knows one heading only; the one nearest to it serves
    result = identify(campaign, reference_at_rest(min(truth, key=lambda m: abs(m.heading_deg))))
    index = [truth[0].labels.index(name) for name in WANTED]
    good = [s for s in result.data.sets if not s.environment.get("excluded")]
    assert len(good) >= 3 and {s.environment["state"] for s in good} == {"idling"}
    identified = np.array([s.measured for s in good])
    assert identified[:, [0, 1, 3, 4]].mean() >= 0.9
    for s in good:
        heading = s.environment["nacelle_heading_deg"]
        near = min(truth, key=lambda m: abs((m.heading_deg - heading + 180) % 360 - 180))
        error = s.frequency_hz / near.frequency_hz[index] - 1
        # 2 % are some five standard deviations of the weakest of them in half an hour
        row.error(error[np.isfinite(error)], below=0.02, of="frequencies")
        for pair in ([0, 1], [3, 4]):
            if s.measured[pair].all():
                row.least(plane_mac(s.shape[:, pair], near.shape[:, [index[k] for k in pair]]), above=0.95, of="planes")
    chosen = select(result.data)
    times = pd.to_datetime([s.id for s in chosen.data.sets])
    assert len(times) >= 2 and chosen.data.set().id in {s.id for s in good}
