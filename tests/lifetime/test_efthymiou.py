"""Efthymiou's factors: numbers of a public implementation, limits of the equations, ranges."""

import numpy as np
import pytest

from probupdate.lifetime.efthymiou import Geometry, cross, kay, tee, validity_violations


def geometry(**change):
    return Geometry(
        **(
            {
                "chord_diameter_m": 1.2,
                "chord_wall_m": 0.05,
                "chord_length_m": 12.0,
                "brace_diameter_m": 0.8,
                "brace_wall_m": 0.02,
                "angle_deg": 55.0,
            }
            | change
        )
    )


def numbers(*sides):
    return np.array([[s.axial_crown, s.axial_saddle, s.in_plane, s.out_of_plane] for s in sides])


def test_they_are_those_of_another_implementation(validation):
    # a public one of the 1988 equations (numpy), evaluated once; 2000 drawn joints agreed to 4e-16
    row = validation(what="Efthymiou's factors, T and Y, X, K, both sides",
                     reference="a public implementation of the 1988 equations, evaluated outside this repository",
                     why="rounding")
    row.error(numbers(*tee(geometry(), 0.7)) / np.array(
        [
            [2.617052315324027, 3.7957022032022327, 1.5008431725004978, 3.2299865431646797],
            [2.799941631491233, 3.8751503915010055, 2.37433800853013, 3.2398856066565185],
        ]) - 1, below=1e-12)
    row.error(numbers(*cross(geometry(), 0.7)) / np.array(
        [
            [1.0879684993179088, 5.452277078260964, 1.5008431725004978, 3.0123572276341175],
            [2.3732749648245663, 4.575374817665713, 2.37433800853013, 3.0215893142257952],
        ]) - 1, below=1e-12)
    other = geometry(brace_diameter_m=0.7, brace_wall_m=0.025, angle_deg=48.0)
    row.error(numbers(*kay(geometry(), other, 0.12)) / np.array(
        [
            [2.488003400475101, 2.488003400475101, 1.5008431725004978, 4.097594181075943],
            [2.3562540875299103, 2.3562540875299103, 2.37433800853013, 4.110152234931646],
        ]) - 1, below=1e-12)


def test_short_chords_are_stiffer_and_long_ones_no_more():
    long, short = geometry(chord_length_m=7.3), geometry(chord_length_m=3.0)
    assert long.alpha > 12 > short.alpha
    assert tee(short, 0.5)[0].axial_saddle < tee(long, 0.5)[0].axial_saddle
    assert tee(short, 0.5)[0].out_of_plane < tee(long, 0.5)[0].out_of_plane
    assert cross(short, 0.7)[0].axial_saddle < cross(long, 0.7)[0].axial_saddle
    # at the border the correction has faded
    near = geometry(chord_length_m=7.1999)
    assert cross(near, 0.7)[0].axial_saddle == pytest.approx(
        cross(geometry(chord_length_m=7.2001), 0.7)[0].axial_saddle, rel=1e-3
    )


def test_a_k_with_a_wide_gap_bends_as_its_brace_alone():
    wide = kay(geometry(angle_deg=90.0), geometry(angle_deg=90.0), 1.2)[0].out_of_plane
    narrow = kay(geometry(angle_deg=90.0), geometry(angle_deg=90.0), 0.0)[0].out_of_plane
    alone = tee(geometry(angle_deg=90.0), 0.5)[0].out_of_plane
    assert narrow > wide and wide == pytest.approx(alone, rel=0.1)


def test_ranges_are_said():
    assert validity_violations(geometry()) == []
    found = validity_violations(geometry(brace_diameter_m=0.2, angle_deg=15.0), gap_m=1.5)
    assert len(found) == 3 and found[0] == "beta = 0.167 is not within 0.2 to 1" and "zeta = 1.25" in found[2]
