"""Every figure alone: labelled axes with units, the same text for the same input, no global state left behind."""

from __future__ import annotations

import re
import subprocess
import sys
from contextlib import nullcontext

import matplotlib
import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from probupdate.model.parameters import Parameter
from probupdate.reporting import figures, figures_identification, style
from probupdate.reporting.figures_diagnosis import row_of


def standard(name: str) -> Parameter:
    return Parameter(name=name, unit="-", initial=0.0, std=1.0)


def _built(run) -> dict[str, Figure]:
    """One of each kind, from the made-up run."""
    update, posterior, scada, modes = run.update, run.posterior, run.campaign.scada, run.modes
    time = run.poles["time"].to_numpy()
    frequency = run.poles["frequency_hz"].to_numpy()
    mark = figures.Mark(name="MAP", theta=update.map_theta, role={"color": "k", "marker": "o", "linestyle": "-"})
    block_hz = np.array([s.frequency_hz for s in modes.sets])
    block_time = np.array([s.id[:-1] for s in modes.sets], dtype="datetime64[m]")
    names = update.parameters.names
    wire, moved = run.model.wire, run.model.states["updated"].displacement
    shown, content = run.diagnosis["details"]["residuals"], run.diagnosis
    states = shown["states"]
    return {
        "causes": figures.causes(content["findings"]),
        "sizes_found": figures.sizes_found(content["findings"], ("leg stiffness, leg B, bay 4: factor 0.75",)),
        "mode_residuals": figures.mode_residuals(shown["modes"], states),
        "residual_map": figures.residual_map(shown["channels"], states),
        "residual_layout": figures.residual_layout(shown["sensors"], shown["channels"], states),
        "calendar": figures.calendar(shown["time"], states, ["2019-06-03T12:00Z"]),
        "against_covariates": figures.against_covariates(shown["covariates"], states, ["water_level_m"]),
        "prior_shifts": figures.prior_shifts(shown["prior_shift"]["parameters"], states),
        "detectable_sizes": figures.detectable_sizes([x for x in content["detectable_sizes"] if x["size"]],
                                                     {("scour", "all legs"): 0.05}),
        "estimate_paths": figures.estimate_paths(
            update.parameters.items, [(0, 1)], posterior.draws, update.scheme("step").theta, 0,
            np.array([0.1, 1.0, 10.0]), update.scheme("prior").theta[[-1, -1, 0]], mark),
        "sensor_layout": figures.sensor_layout(wire, run.campaign.sensors),
        "sensor_layout without model": figures.sensor_layout(None, run.campaign.sensors),
        "wind_and_state": figures.wind_and_state(
            scada["time"].to_numpy(), scada["wind_speed_mps"], list(scada["state"]), cut_in_mps=4.0, rated_mps=12.0),
        "poles": figures.poles({"poles": (time, frequency)}, harmonics_hz={"1P": 0.25, "3P": 0.74}),
        "mode_shapes": figures.mode_shapes(wire, update.labels, {"updated": moved}),
        "shapes_by_channel": figures.shapes_by_channel(["a", "b"], np.eye(4)[:, :2], np.full((4, 2), 0.1),
                                                       {"initial": np.eye(4)[:, :2]}),
        "selection_steps": figures.selection_steps(["not idling", "yawing"], [20, 5], 48),
        "frequencies_by_block": figures.frequencies_by_block(block_time, block_hz, modes.labels,
                                                             np.arange(len(block_hz)) < 9, np.full(5, 0.32)),
        "frequency_errors": figures.frequency_errors(update.labels, update.measured_hz, {"initial": update.initial_hz}),
        "parameter_shifts": figures.parameter_shifts(update.parameters.items, posterior.draws, [mark]),
        "variance_shares": figures.variance_shares(("k_t", "py"), ("identification", "prior"),
                                                   np.array([[0.3, 0.9], [0.7, 0.1]])),
        "update_history": figures.update_history({s.key: s.objective for s in update.schemes},
                                                 {s.key: s.theta for s in update.schemes}, names,
                                                 update.parameters.initial,
                                                 {s.key: s.distance_to_map for s in update.schemes}),
        "marginals": figures.marginals(update.parameters.items, posterior.draws, [mark]),
        "corner": figures.corner(update.parameters.items[:3], posterior.draws[:, :3], [mark]),
        "correlation_map": figures.correlation_map(names, np.corrcoef(posterior.draws.T)),
        "traces_and_ranks": figures.traces_and_ranks(names, ["-"] * 10, posterior.theta, posterior.ess),
        "contraction": figures.contraction(names, np.linspace(0.05, 1, 10), informed_below=0.9, strong_below=0.5),
        "stabilisation": figures.stabilisation(
            np.linspace(0.1, 2.5, 50), np.ones(50), np.array([10, 12, 14]), np.array([0.31, 0.312, 1.3]),
            [*figures_identification.STEADINESS][:1] * 3, chosen_hz={"FA1": 0.311}, harmonics_hz={"3P": (0.5, 0.6)}),
        "mac_map": figures.mac_map(np.eye(2), ["a", "b"], ["a", "b"], across="mode", up="mode"),
        "mpc_map": figures.mpc_map(block_time, modes.labels, np.full(block_hz.shape, 0.9)),
        "argand": figures.argand(["a", "b"], np.eye(4)[:, :2] * (1 + 0.1j)),
        "against_conditions": figures.against_conditions(
            modes.labels, block_hz, 0.01 * block_hz, {"wind speed [m/s]": np.arange(len(block_hz), dtype=float)}),
        "predictive_frequencies": figures.predictive_frequencies(
            update.labels, update.measured_hz, update.measured_std_hz, posterior.frequency_hz),
    }


@pytest.fixture(scope="module")
def built(full_run):
    return _built(full_run)


NAMES = (
    "sensor_layout", "sensor_layout without model", "wind_and_state", "poles", "mode_shapes", "selection_steps",
    "frequencies_by_block", "frequency_errors", "update_history", "marginals", "corner", "correlation_map",
    "contraction", "parameter_shifts", "predictive_frequencies", "shapes_by_channel",
    "traces_and_ranks", "estimate_paths", "stabilisation", "mac_map", "mpc_map", "argand", "against_conditions",
    "causes", "mode_residuals", "residual_map", "residual_layout", "calendar", "against_covariates",
    "prior_shifts", "detectable_sizes", "variance_shares", "sizes_found",
)


def test_the_list_of_figures_is_complete(built):
    drawn = {name.split()[0] for name in built}
    functions = set(figures.__all__) - {"Mark", "svg_text", "unit_label"}
    assert set(built) == set(NAMES) and drawn == functions


def _column_and_row_mates(axes, which: str) -> list:
    grouper = axes.get_shared_x_axes() if which == "x" else axes.get_shared_y_axes()
    return grouper.get_siblings(axes)


def _along(figure, axes, which: str) -> set[str]:
    """Labels of the panels in the same column (x) or row (y)."""
    span = "colspan" if which == "x" else "rowspan"
    panels = [a for a in figure.axes if a.get_label() != "<colorbar>"]
    here = getattr(axes.get_subplotspec(), span)
    return {getattr(a, f"get_{which}label")() for a in panels if getattr(a.get_subplotspec(), span) == here}


@pytest.mark.parametrize("name", NAMES)
def test_every_axis_is_labelled_with_its_unit(built, name):
    figure = built[name]
    assert figure.axes
    for axes in figure.axes:
        if axes.get_label() == "<colorbar>":
            assert "[" in axes.get_ylabel()
            continue
        for which in "xy":
            # panels that share an axis may leave the label to the outermost of them
            label = getattr(axes, f"get_{which}label")()
            mates = {getattr(a, f"get_{which}label")() for a in _column_and_row_mates(axes, which)}
            said = {label} if label.strip() else mates | _along(figure, axes, which)
            assert any(text.strip() for text in said), f"{name}: the {which} axis has no label"
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            words = ("mode", "criterion", "parameter", "density", "iteration", "number of blocks", "channel",
                     "candidate", "cause, place", "finding", "mode (i: out of phase)", "")
            assert "[" in label or label in words, f"{name}: '{label}' has no unit"


def test_svg_is_the_same_every_time(full_run, built):
    one, two = built, _built(full_run)
    for name in ("poles", "marginals", "selection_steps", "sensor_layout", "traces_and_ranks"):
        first, again = figures.svg_text(one[name], "a"), figures.svg_text(two[name], "a")
        assert first == again
        assert first.startswith("<svg") and first.endswith("</svg>")
        assert "<dc:date>" not in first and "<metadata" not in first


def test_ticks_found_once_are_the_same_picture(full_run, monkeypatch):
    update, count, pictures = Axis._update_ticks, [0, 0], []

    def counted(axis):
        count[len(pictures)] += 1
        return update(axis)

    monkeypatch.setattr(Axis, "_update_ticks", counted)
    for way in (style.ticks_found_once, nullcontext):
        monkeypatch.setattr(style, "ticks_found_once", way)
        # places and ranges that change from round to round: equal scales, a colour bar, aligned labels of dates
        pictures.append([figures.svg_text(figure, "a") for figure in _moving(full_run)])
    assert pictures[0] == pictures[1]
    # once for each round of the layout and for the drawing, in place of some ten times
    assert 2.5 * count[0] < count[1]


def _moving(run) -> list[Figure]:
    modes = run.modes
    time = np.array([s.id[:-1] for s in modes.sets], dtype="datetime64[m]")
    return [figures.sensor_layout(None, run.campaign.sensors),
            figures.mpc_map(time, modes.labels, np.full((len(time), modes.n_mode), 0.9)),
            figures.frequencies_by_block(time, np.array([s.frequency_hz for s in modes.sets]), modes.labels,
                                         np.arange(len(time)) < 9)]


def test_prefix_keeps_the_ids_of_two_figures_apart(built):
    one = set(re.findall(r'\bid="([^"]+)"', figures.svg_text(built["poles"], "one")))
    two = set(re.findall(r'\bid="([^"]+)"', figures.svg_text(built["poles"], "two")))
    assert one and not one & two


def test_many_poles_become_an_image_and_few_do_not():
    rng = np.random.default_rng(1)
    time = np.datetime64("2019-06-01") + np.arange(20000).astype("timedelta64[m]")
    text = figures.svg_text(figures.poles({"poles": (time, rng.uniform(0, 2.5, 20000))}), "m")
    assert "data:image/png" in text and len(text) < 1e6
    few = figures.svg_text(figures.poles({"poles": (time[:100], rng.uniform(0, 2.5, 100))}), "m")
    assert "data:image/png" not in few


def test_matplotlib_is_left_as_it_was(full_run):
    before = dict(matplotlib.rcParams)
    figures.selection_steps(["a"], [1], 3)
    figures.svg_text(figures.selection_steps(["a"], [1], 3), "x")
    assert dict(matplotlib.rcParams) == before


def test_no_figure_needs_a_window_system():
    code = (
        "import sys; import numpy; from probupdate.reporting import figures as f; "
        "from probupdate.model.parameters import Parameter as P; "
        "draws = numpy.random.default_rng(1).normal(size=(500, 2)); "
        "two = [P(name=n, unit='-', initial=0.0, std=1.0) for n in 'ab']; "
        "f.svg_text(f.corner(two, draws, []), 'x'); print('matplotlib.pyplot' in sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "False"


def test_names_are_drawn_as_they_are_written():
    text = figures.svg_text(figures.contraction(["$k_{j}$ & <b>"], [0.3], informed_below=0.9, strong_below=0.5), "n")
    assert "$k_{j}$ &amp; &lt;b&gt;" in text


def test_contours_hold_their_share_of_the_draws():
    """39, 68 and 90 %: of a Gaussian's draws the innermost contour holds what a circle of one standard deviation
    holds."""
    rng = np.random.default_rng(2)
    draws = rng.standard_normal((40000, 2))
    figure = figures.corner([standard("a"), standard("b")], draws, [])
    pair = next(a for a in figure.axes if a.get_ylabel().startswith("b") and a.collections)
    lines = pair.collections[1]
    levels = lines.levels if hasattr(lines, "levels") else None
    assert levels is not None and len(levels) == 3
    # the innermost contour of the standard normal holding 39 % is the unit circle
    path = lines.get_paths()[-1].vertices
    radius = np.linalg.norm(path, axis=1)
    assert np.median(radius) == pytest.approx(np.sqrt(-2 * np.log(1 - 0.39)), abs=0.12)


def _rank_panel(theta: np.ndarray, effective: float):
    figure = figures.traces_and_ranks(["a"], ["-"], theta, np.array([effective]))
    panel = figure.axes[1]
    band = panel.patches[0]
    low, high = band.get_y(), band.get_y() + band.get_height()
    shares = np.concatenate([p.get_data().values for p in panel.patches[1:]])
    return np.mean((shares < low) | (shares > high))


def test_ranks_of_parts_that_tell_the_same_stay_in_their_band():
    """Independent draws: of 80 shares at two standard deviations about 5 % lie outside; three times that is chance of
    1e-4."""
    theta = np.random.default_rng(4).standard_normal((16, 500, 1))
    assert _rank_panel(theta, 8000.0) < 0.15


def test_ranks_of_a_drifting_chain_leave_their_band():
    theta = np.random.default_rng(4).standard_normal((16, 500, 1)) + np.linspace(0, 2, 500)[:, None]
    assert _rank_panel(theta, 8000.0) > 0.5


def test_a_trace_goes_where_the_ensemble_goes():
    theta = np.random.default_rng(4).standard_normal((16, 600, 1)) + np.linspace(0, 5, 600)[:, None]
    trace = figures.traces_and_ranks(["a"], ["-"], theta, np.array([50.0]), thinned_by=3).axes[0]
    step, median = trace.lines[0].get_data()
    # 600 steps kept, each the third: the axis counts what the sampler did
    assert step[-1] == pytest.approx(1800, rel=0.01)
    assert median[0] == pytest.approx(0, abs=0.5) and median[-1] == pytest.approx(5, abs=0.5)


def test_a_narrow_posterior_can_be_read_beside_a_wide_prior():
    draws = np.random.default_rng(6).normal(0.3, 0.01, (4000, 1))
    axes = figures.marginals([Parameter(name="k", unit="-", initial=1.0, std=1.0, lower=0.05)], draws, []).axes[0]
    width = np.ptp(np.percentile(draws, [0.2, 99.8]))
    assert np.ptp(axes.get_xlim()) < 5 * width


def test_steps_of_rows_that_read_alike_stand_beside_their_own():
    """Two braces of one face had the same words, and the step of the second stood beside both."""
    def entry(row, profile, size):
        return {"row": row, "kind": "structural", "cause": "stiffness", "location": "face AB, bay 1", "unit": "-",
                "time_profile": profile, "size": size, "share_left": 0.5, "z": 0.1}

    steps = {row_of(x): x["size"] for x in (entry(0, "step", 0.01), entry(1, "step", 0.02))}
    figure = figures.detectable_sizes([entry(0, "constant", 0.3), entry(1, "constant", 0.4)], steps)
    (marks,) = figure.axes[0].lines
    assert marks.get_xdata().tolist() == [0.01, 0.02]
    # a file of before has no numbers
    assert row_of({"cause": "stiffness", "location": "leg A"}) == ("stiffness", "leg A")


@pytest.mark.parametrize("most", [8e-4, 3e-2])
def test_logarithmic_axes_have_plain_labels(most, tmp_path):
    """Where dollar signs are letters, matplotlib's powers of ten stood there as TeX."""
    def drawn():
        figure = style.new_figure(4.0, 3.0)
        axis = figure.subplots()
        axis.scatter([1.0, 2.0], [2e-4, most])
        axis.set_yscale("log")
        return figure

    style.save_figure(figure := style.with_style(drawn)(), tmp_path / "log.svg")
    figure.canvas.draw()
    labels = [t.get_text() for m in (False, True) for t in figure.axes[0].get_yticklabels(minor=m) if t.get_text()]
    assert len(labels) >= 2 and all(float(text.replace("−", "-")) > 0 for text in labels)
    for text in ((tmp_path / "log.svg").read_text("utf-8"), style.svg_text(style.with_style(drawn)(), "one")):
        assert "mathdefault" not in text


def test_a_mode_that_nothing_shows_has_no_panel(full_run):
    """T1 that no block holds stood there as five empty panels."""
    wire, moved = full_run.model.wire, np.array(full_run.model.states["updated"].displacement[:, :, :3])
    moved[:, :, 1] = np.nan
    drawn = figures.mode_shapes(wire, ["FA1", "T1", "SS1"], {"updated": moved})
    assert [axes.get_title(loc="left") for axes in drawn.axes] == ["FA1", "SS1"]
    hz = np.array([[0.3, np.nan, 0.31], [0.301, np.nan, 0.312]])
    wind = {"wind speed [m/s]": np.array([4.0, 7.0]), "temperature [degC]": np.array([2.0, 9.0])}
    drawn = figures.against_conditions(["FA1", "T1", "SS1"], hz, 0.01 * hz, wind)
    assert [axes.get_ylabel() for axes in drawn.axes] == ["FA1 [%]", "", "SS1 [%]", ""]
