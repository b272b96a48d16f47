"""One default for an option and for the keyword behind it, or the field of a settings value: the settings' own."""

import argparse
import dataclasses
import inspect

import numpy as np
import pytest
from command_cases import write_campaign
from scipy import signal

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.cli import build_parser
from probupdate.errors import InputError
from probupdate.identification.reference import ReferenceModes
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.verbs.identifying import ssi_settings, unexplained_peaks

(VERBS,) = (a.choices for a in build_parser()._actions if a.dest == "verb")
# option -> keyword or field, where the names differ
KEYWORDS = {"set": "set_id", "ess": "target_ess", "rate": "rate_hz", "rated_power": "rated_power_kw"}
# the command line takes one process a core
OWN = {("identify", "jobs")}


@pytest.mark.parametrize("verb", ("update", "sample", "sets", "inform", "identify", "select", "diagnose"))
def test_an_option_has_its_keywords_default(verb):
    defaults = {name: p.default for name, p in inspect.signature(getattr(probupdate, verb)).parameters.items()
                if p.default is not inspect.Parameter.empty}
    for value in [v for v in defaults.values() if dataclasses.is_dataclass(v)]:
        defaults |= {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    compared = 0
    for action in VERBS[verb]._actions:
        keyword = KEYWORDS.get(action.dest, action.dest)
        if keyword not in defaults or (verb, action.dest) in OWN:
            continue
        # a former name of an option leaves the default to the option itself
        if action.default is argparse.SUPPRESS:
            assert action.help is argparse.SUPPRESS
            continue
        compared += 1
        assert action.default == defaults[keyword], action.dest
    assert compared >= 3


def test_the_papers_rate_gives_way_to_one_that_holds_the_modes(tmp_path):
    """Small lattice towers have members too: their second bending may lie above 2.5 Hz."""
    model = tmp_path / "model.toml"
    model.write_text("[subdyn]\nfile = \"tower.dat\"\n")
    noise, data = np.random.default_rng(1).standard_normal((2, 6000)), np.zeros((6000, 3))
    for mode, hz in enumerate((0.3, 3.6)):
        pole = np.exp(2j * np.pi * hz / 10 * (1 + 0.01j))
        data[:, mode] = signal.lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], noise[mode])
    data[:, 2] = data[:, :2].sum(axis=1)
    campaign = read_campaign(write_campaign(tmp_path / "campaign", data=data))

    def rate_for(highest_hz, **given):
        shape = np.eye(3)[:, :2]
        reference = ReferenceModes(labels=("FA1", "SS1"), frequency_hz=np.array([0.3, highest_hz]), shape=shape)
        return ssi_settings([campaign], model, probupdate.IdentificationSettings(**given), reference)[0].target_rate_hz

    assert rate_for(1.9) == 5.0
    assert 7.2 < rate_for(3.6) <= 10.0
    # what is given is not changed, and what was recorded not exceeded
    for highest_hz, given in ((3.6, {"rate_hz": 5.0}), (6.0, {})):
        with pytest.raises(InputError, match="shows nothing above"):
            rate_for(highest_hz, **given)


def test_blocks_of_few_periods_of_the_model_s_lowest_mode_are_said(tmp_path):
    """Fewer than 16 of a mode of 1 % damping bound its damping ratio by nothing less than itself."""
    noise = np.random.default_rng(2).standard_normal((8000, 3))
    pole = np.exp(2j * np.pi * 0.3 / 10 * (1 + 0.01j))
    sway = signal.lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], noise[:, 0])[2000:]
    data = np.outer(sway / sway.std(), [1.0, 0.7, 0.3]) + 0.01 * noise[2000:]
    records = {name: read_campaign(write_campaign(tmp_path / name, data=x)) for name, x in (
        ("sway", data), ("noise", noise[2000:]))}

    def said(lowest_hz, of="sway"):
        reference = ReferenceModes(labels=("X1",), frequency_hz=np.array([lowest_hz]), shape=np.ones((3, 1)))
        _, notes, _ = ssi_settings([records[of]], None, probupdate.IdentificationSettings(), reference)
        return [text for text in notes if text.startswith("too few periods")]

    assert "12 periods of the model's lowest mode (0.02 Hz)" in said(0.02)[0]
    assert "block_minutes of 14 or more" in said(0.02)[0]
    assert said(0.03) == []
    # what is stated is said as it is used
    _, notes, _ = ssi_settings([records["sway"]], None, probupdate.IdentificationSettings(order=44))
    assert any("order 44, " in text and text.endswith("; order as stated") for text in notes)
    # the reason where nothing is found at all
    with pytest.raises(InputError, match="no peak.*1.2 periods of the model's lowest mode.*block_minutes of 134"):
        said(0.002, of="noise")


@pytest.mark.parametrize("size", [0.01, 0.5])
def test_a_peak_without_a_mode_is_said(tmp_path, size):
    """Of three modes one of a hundredth of the others' motion is a peak of the spectrum and no mode in any block."""
    rng, data = np.random.default_rng(3), np.zeros((40_000, 3))
    for hz, amplitude, shape in ((0.4, 1.0, [1, 0.6, 0.3]), (1.9, size, [1, -0.8, -0.5]), (3.1, 0.5, [1, 0.2, -1])):
        pole = np.exp(2 * np.pi * hz / 10 * (1j - 0.01))
        motion = signal.lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(len(data)))
        data += amplitude * np.outer(motion / motion.std(), shape)
    data += 0.02 * rng.standard_normal(data.shape)
    found = probupdate.identify(write_campaign(tmp_path / "campaign", data=data))
    frequencies = np.concatenate([s.frequency_hz[s.measured] for s in found.data.sets])
    said = [text for text in found.notes if "no mode was found at the spectrum's peak at 1.9 Hz" in text]
    assert len(said) == (not np.any(np.abs(frequencies - 1.9) < 0.05)) == (size < 0.1)


def test_a_peak_between_two_close_modes_may_be_where_they_cross():
    own = np.full(3, 0.01)
    one = ModalSet(id="a", frequency_hz=np.array([0.588, 0.68, 1.5]), damping_ratio=own, shape=np.eye(4)[:, :3],
                   frequency_std_hz=own, shape_std=np.full((4, 3), 0.01))
    alone, between = unexplained_peaks([0.59, 0.624, 1.9], ModalData(channels=tuple("abcd"), sets=(one,)))
    assert "at 1.9 Hz" in alone and "at 0.624 Hz" in between and "beside it cross" in between
    assert "0.59 Hz" not in alone + between and "cross" not in alone
