// Mode shapes of a wireframe on a canvas: drag turns, wheel zooms, buttons choose the mode. No library.
"use strict";
(function () {
  const STYLE = {
    rest: { color: "#b9c1ca", dash: [], width: 0.8 },
    initial: { color: "#8a6d3b", dash: [6, 4], width: 1.1 },
    updated: { color: "#0072b2", dash: [], width: 1.6 },
    measured: { color: "#c43c00", dash: [], width: 1.4 },
  };
  const HEAVY = { tower: 1.9, column: 1.9, leg: 1.5, pile: 1.3, deck: 1.3 };

  function element(tag, attributes, text) {
    const e = document.createElement(tag);
    for (const key in attributes) e.setAttribute(key, attributes[key]);
    if (text !== undefined) e.textContent = text;
    return e;
  }

  function start(box) {
    const data = JSON.parse(box.querySelector("script").textContent);
    const still = window.matchMedia && window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    const home = data.view || { azimuth: -0.95, elevation: 0.2 };
    const state = { mode: 0, azimuth: home.azimuth, elevation: home.elevation, zoom: 1, shift: [0, 0], phase: Math.PI / 2,
                    playing: !still, amplitude: 1, shown: {}, visible: false, last: null };
    data.states.forEach((s) => { state.shown[s.key] = true; });

    const bar = element("div", { class: "bar" });
    const canvas = element("canvas", { tabindex: "0", role: "img", "aria-label": "Mode shape of the structure" });
    const foot = element("div", { class: "foot" });
    box.append(bar, canvas, foot);

    const modeButtons = (data.modes.length > 1 ? data.modes : []).map((mode, k) => {
      const b = element("button", { type: "button", "aria-pressed": String(k === 0) }, mode.label);
      b.addEventListener("click", () => { state.mode = k; state.phase = Math.PI / 2; refresh(); });
      bar.append(b);
      return b;
    });
    const play = element("button", { type: "button", "aria-pressed": "false" }, "");
    play.addEventListener("click", () => { state.playing = !state.playing; if (!state.playing) state.phase = Math.PI / 2; refresh(); });
    bar.append(element("span", {}, "\u00a0"), play);
    [["front", 0, 0], ["side", -Math.PI / 2, 0], ["above", -Math.PI / 2, Math.PI / 2], ["reset", null, null]].forEach(([name, a, e]) => {
      const b = element("button", { type: "button" }, name);
      b.addEventListener("click", () => {
        state.azimuth = a === null ? home.azimuth : a; state.elevation = e === null ? home.elevation : e;
        // from above a tall structure is small: drawn as large as its plan allows
        const plan = Math.max(high[0] - low[0], high[1] - low[1], 0.05 * reach);
        state.zoom = e === Math.PI / 2 && !data.wide ? Math.min(0.5 * reach / plan, 8) : 1;
        state.shift = [0, 0];
        draw();
      });
      bar.append(b);
    });
    data.states.forEach((s) => {
      const l = element("label", {});
      const c = element("input", { type: "checkbox" });
      c.checked = true;
      c.addEventListener("change", () => { state.shown[s.key] = c.checked; draw(); });
      const swatch = element("span", { class: "swatch" });
      swatch.style.borderTopColor = STYLE[s.key].color;
      if (STYLE[s.key].dash.length) swatch.style.borderTopStyle = "dashed";
      if (s.key === "measured") swatch.style.borderTopStyle = "dotted";
      l.append(c, swatch, element("span", {}, s.name));
      bar.append(l);
    });
    const size = element("label", {}, "amplitude ");
    const slider = element("input", { type: "range", min: "0.2", max: "3", step: "0.1", value: "1", "aria-label": "amplitude" });
    slider.addEventListener("input", () => { state.amplitude = Number(slider.value); draw(); });
    size.append(slider);
    bar.append(size);

    // the picture's centre and size
    const points = data.nodes.length ? data.nodes : data.sensors;
    const low = [0, 1, 2].map((i) => Math.min(...points.map((p) => p[i])));
    const high = [0, 1, 2].map((i) => Math.max(...points.map((p) => p[i])));
    const centre = low.map((v, i) => 0.5 * (v + high[i]));
    const reach = Math.max(...high.map((v, i) => v - low[i])) || 1;

    let width = 0, height = 0, context = canvas.getContext("2d");
    function fit() {
      const ratio = window.devicePixelRatio || 1;
      width = canvas.clientWidth; height = canvas.clientHeight;
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      draw();
    }

    function project(p) {
      const x = p[0] - centre[0], y = p[1] - centre[1], z = p[2] - centre[2];
      const ca = Math.cos(state.azimuth), sa = Math.sin(state.azimuth), ce = Math.cos(state.elevation), se = Math.sin(state.elevation);
      // seen from azimuth a: right axis (-sin a, cos a), depth axis (cos a, sin a)
      const right = -sa * x + ca * y, away = ca * x + sa * y;
      const up = ce * z - se * away;
      const scale = 0.88 * Math.min(width / (data.wide ? Math.hypot(high[0] - low[0], high[1] - low[1]) * 1.05 : reach * 0.9), height / reach * (data.wide ? 3 : 1)) * state.zoom;
      return [0.5 * width + state.shift[0] + scale * right, 0.5 * height + state.shift[1] - scale * up];
    }

    // where a point is in this phase; the imaginary part of a complex shape is ahead of the real one by a quarter
    function moved(p, real, imaginary) {
      const a = data.scale * state.amplitude * Math.sin(state.phase), b = data.scale * state.amplitude * Math.cos(state.phase);
      return real ? p.map((v, i) => v + a * real[i] + (imaginary ? b * imaginary[i] : 0)) : p;
    }

    function strokeLines(shape, imaginary, style, thick) {
      context.strokeStyle = style.color; context.setLineDash(style.dash);
      const place = data.nodes.map((p, k) => project(moved(p, shape && shape[k], imaginary && imaginary[k])));
      data.lines.forEach(([i, j], k) => {
        context.lineWidth = style.width * (thick ? (HEAVY[data.groups[k]] || 1) : 1);
        context.beginPath(); context.moveTo(place[i][0], place[i][1]); context.lineTo(place[j][0], place[j][1]); context.stroke();
      });
      context.setLineDash([]);
      // nodes that no line joins are all there is to see of some models
      if (!data.lines.length) {
        context.fillStyle = style.color;
        place.forEach((q) => { context.beginPath(); context.arc(q[0], q[1], thick ? 2.6 : 1.8, 0, 2 * Math.PI); context.fill(); });
      }
    }

    function plane(level) {
      const half = 0.5 * Math.max(high[0] - low[0], high[1] - low[1]) * 1.5;
      const c = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => project([centre[0] + a * half, centre[1] + b * half, level.z]));
      context.beginPath(); c.forEach((p, k) => (k ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1]))); context.closePath();
      context.fillStyle = level.color; context.fill();
      context.strokeStyle = "#aab4bf"; context.lineWidth = 0.6; context.stroke();
      if (state.elevation > 1.2) return; // seen from above the planes lie upon one another
      const edge = c.reduce((a, b) => (a[0] > b[0] ? a : b));
      context.fillStyle = "#55606d"; context.font = "11.5px sans-serif"; context.textBaseline = "middle";
      context.fillText(level.name, edge[0] + 6, edge[1]);
    }

    function axes() {
      const names = ["x", "y", "z"], origin = [38, height - 38];
      const zero = project(centre);
      names.forEach((name, i) => {
        const tip = centre.slice(); tip[i] += reach;
        const q = project(tip), d = [q[0] - zero[0], q[1] - zero[1]];
        const unit = 26 / (reach * (Math.hypot(...project([centre[0], centre[1], centre[2] + reach]).map((v, k) => v - zero[k])) / reach || 1));
        const full = Math.max(Math.hypot(...d), 1e-9), length = Math.min(full * unit, 30);
        const end = [origin[0] + d[0] / full * length, origin[1] + d[1] / full * length];
        context.strokeStyle = "#55606d"; context.lineWidth = 1; context.beginPath(); context.moveTo(...origin); context.lineTo(...end); context.stroke();
        context.fillStyle = "#55606d"; context.font = "11px sans-serif"; context.textAlign = "center";
        if (length > 6) context.fillText(name, origin[0] + d[0] / full * (length + 8), origin[1] + d[1] / full * (length + 8));
        context.textAlign = "left";
      });
    }

    function draw() {
      if (!width) return;
      context.clearRect(0, 0, width, height);
      const mode = data.modes[state.mode];
      (data.planes || []).forEach(plane);
      strokeLines(null, null, STYLE.rest, false);
      ["initial", "updated"].forEach((key) => {
        const v = mode.variants[key];
        if (v && v.shape && state.shown[key]) strokeLines(v.shape, null, STYLE[key], key === "updated");
      });
      const measured = mode.variants.measured;
      if (measured && measured.wire && state.shown.measured) strokeLines(measured.wire, measured.wire_im, STYLE.measured, true);
      if (measured && measured.shape && state.shown.measured) {
        context.lineWidth = STYLE.measured.width; context.strokeStyle = STYLE.measured.color;
        data.sensors.forEach((p, k) => {
          const d = measured.shape[k];
          if (d === null) return;
          const a = project(p), b = project(moved(p, d, measured.shape_im && measured.shape_im[k]));
          context.beginPath(); context.moveTo(...a); context.lineTo(...b); context.stroke();
          context.beginPath(); context.arc(b[0], b[1], 4.2, 0, 2 * Math.PI); context.fillStyle = "#fff"; context.fill(); context.stroke();
          context.beginPath(); context.arc(b[0], b[1], 1.4, 0, 2 * Math.PI); context.fillStyle = STYLE.measured.color; context.fill();
        });
      }
      axes();
    }

    function refresh() {
      modeButtons.forEach((b, k) => b.setAttribute("aria-pressed", String(k === state.mode)));
      play.textContent = state.playing ? "pause" : "play";
      play.setAttribute("aria-pressed", String(state.playing));
      const mode = data.modes[state.mode];
      foot.replaceChildren(element("strong", {}, mode.label + (mode.name ? ": " + mode.name : "")));
      data.states.forEach((s) => {
        const v = mode.variants[s.key];
        foot.append(element("span", {}, s.name + ": " + (v && v.hz !== null ? v.hz.toFixed(3) + " Hz" : "no frequency") + (v && v.note ? ", " + v.note : "")));
      });
      draw();
      animate();
    }

    // one loop at a time, whatever is clicked while it plays
    let pending = 0;
    function animate() {
      if (pending || !state.playing || !state.visible) return;
      state.last = null;
      pending = requestAnimationFrame(step);
    }
    function step(now) {
      pending = 0;
      if (!state.playing || !state.visible) return;
      if (state.last !== null) state.phase += Math.min(now - state.last, 60) / 1000 * 2 * Math.PI * 0.45;
      state.last = now;
      draw();
      pending = requestAnimationFrame(step);
    }

    let grip = null;
    canvas.addEventListener("pointerdown", (e) => { grip = [e.clientX, e.clientY, e.shiftKey || e.button === 2]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", (e) => {
      if (!grip) return;
      const dx = e.clientX - grip[0], dy = e.clientY - grip[1];
      if (grip[2]) { state.shift[0] += dx; state.shift[1] += dy; } else {
        state.azimuth -= dx * 0.008;
        state.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, state.elevation + dy * 0.008));
      }
      grip[0] = e.clientX; grip[1] = e.clientY;
      draw();
    });
    ["pointerup", "pointercancel"].forEach((n) => canvas.addEventListener(n, () => { grip = null; }));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    // a page is scrolled with the wheel too: it zooms only once the picture was clicked
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas) return;
      e.preventDefault();
      state.zoom = Math.max(0.3, Math.min(12, state.zoom * Math.exp(-e.deltaY * 0.0012)));
      draw();
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      const turn = { ArrowLeft: [0.08, 0], ArrowRight: [-0.08, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[e.key];
      if (turn) { state.azimuth += turn[0]; state.elevation = Math.max(-1.5708, Math.min(1.5708, state.elevation + turn[1])); }
      else if (e.key === "+") state.zoom *= 1.1;
      else if (e.key === "-") state.zoom /= 1.1;
      else if (e.key === " ") { play.click(); }
      else return;
      e.preventDefault();
      draw();
    });
    // within a closed fold it has no size yet
    // another mode in the place of those that it began with
    box.viewer = { show(mode) { data.modes = [mode]; state.mode = 0; refresh(); } };
    if ("ResizeObserver" in window) new ResizeObserver(fit).observe(canvas);
    else window.addEventListener("resize", fit);
    window.addEventListener("beforeprint", () => { state.playing = false; state.phase = Math.PI / 2; refresh(); });
    if ("IntersectionObserver" in window) {
      new IntersectionObserver((entries) => {
        state.visible = entries[entries.length - 1].isIntersecting;
        animate();
      }).observe(canvas);
    }
    fit();
    refresh();
  }

  document.querySelectorAll("[data-viewer]").forEach(start);
})();
