// Stabilisation diagram of a block: poles are picked as modes or rejected, by click or by keys, and the choice is saved
// as a file. No library.
"use strict";
(function () {
  const holder = document.getElementById("explore-data");
  if (!holder) return;
  const data = JSON.parse(holder.textContent);
  const SVG = "http://www.w3.org/2000/svg";
  const NEAR = 0.01, ALIKE = 0.9; // twins of one mode at two orders
  const INK = "#1d2733", SOFT = "#55606d", BLUE = "#0072b2", RED = "#b84a00";
  const place = (name) => document.querySelector(`[data-explore="${name}"]`);
  const state = { block: null, current: -1, hover: -1, low: 0, high: data.highest_hz, show: "all", click: "picked", reason: "" };
  const ready = {}; // blocks as they are first looked at
  let drawn = {}; // what the diagram shows: scales and marks

  function element(tag, attributes, ...inside) {
    const svg = ["svg", "g", "path", "line", "rect", "text", "circle", "polyline", "title"].includes(tag);
    const e = svg ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const key in attributes) if (attributes[key] !== null) e.setAttribute(key, attributes[key]);
    e.append(...inside.filter((x) => x !== undefined && x !== ""));
    return e;
  }
  const fixed = (x, n) => (x === null || x === undefined ? "–" : x.toFixed(n).replace("-", "−"));
  // as many decimals as the standard deviation needs, four digits without
  const digits = (x, std) => (std ? Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(std)))) : Math.max(0, 3 - Math.floor(Math.log10(x))));

  function opened(id) {
    if (ready[id]) return ready[id];
    const raw = data.blocks.find((b) => b.id === id);
    const bytes = Uint8Array.from(atob(raw.shape), (c) => c.charCodeAt(0));
    const numbers = new DataView(bytes.buffer);
    const n = raw.order.length, m = data.channels.length;
    const shape = (i) => Array.from({ length: m }, (_, c) => [0, 1].map((k) => numbers.getInt16(2 * (2 * (i * m + c) + k), true) / 32767));
    const poles = raw.order.map((order, i) => ({
      i, order, index: raw.index[i], hz: raw.hz[i], damping: raw.damping[i], mpc: raw.mpc[i], steady: raw.steady[i],
      hz_std: raw.hz_std[i], damping_std: raw.damping_std[i], said: raw.words[raw.word[i]], mode: raw.mode[i], shape: null, choice: "", reason: "" }));
    poles.forEach((p) => Object.defineProperty(p, "phi", { get() { return (p.shape = p.shape || shape(p.i)); } }));
    raw.chosen.forEach(([i, choice, reason]) => Object.assign(poles[i], { choice, reason }));
    ready[id] = Object.assign({}, raw, { poles, n });
    return ready[id];
  }
  const block = () => opened(state.block);
  const shownPole = () => block().poles[state.hover >= 0 ? state.hover : state.current];
  const chosen = (what, b) => b.poles.filter((p) => p.choice === what).sort((a, c) => a.hz - c.hz);

  function mac(a, b) {
    let re = 0, im = 0, aa = 0, bb = 0;
    a.forEach(([x, y], k) => {
      const [u, v] = b[k];
      re += x * u + y * v; im += x * v - y * u; aa += x * x + y * y; bb += u * u + v * v;
    });
    return aa * bb > 0 ? (re * re + im * im) / (aa * bb) : 0;
  }

  const STEADY = data.steadiness;
  function values(p) {
    return [
      `${fixed(p.hz, digits(p.hz, p.hz_std))}${p.hz_std ? " ± " + fixed(p.hz_std, digits(p.hz, p.hz_std)) : ""} Hz`,
      `damping ${fixed(100 * p.damping, 2)}${p.damping_std ? " ± " + fixed(100 * p.damping_std, 2) : ""} %`,
      `order ${p.order}, MPC ${fixed(p.mpc, 3)}`, STEADY[p.steady],
      ...(p.said ? [p.said] : []), ...(p.choice ? [p.choice + (p.choice === "rejected" && p.reason ? ": " + p.reason : "")] : []),
      ...(p.hz_std ? [] : ["standard deviation not computed"]),
    ];
  }

  // --- choosing ------------------------------------------------------------------------------------------------------
  function choose(p, what) {
    const b = block();
    let words = "";
    if (p.choice === what) {
      p.choice = ""; words = `${fixed(p.hz, 3)} Hz: no longer ${what}`;
    } else {
      // one mode is picked at one order: another pole of it takes its place
      const twin = what === "picked" && b.poles.find((q) => q !== p && q.choice === "picked" && q.order !== p.order && Math.abs(Math.log(q.hz / p.hz)) <= NEAR && mac(p.phi, q.phi) >= ALIKE);
      if (twin) twin.choice = "";
      p.choice = what;
      p.reason = what === "rejected" ? state.reason.slice(0, 200) : "";
      words = `${fixed(p.hz, 3)} Hz of order ${p.order}: ${what}${twin ? ` in place of order ${twin.order}` : ""}`;
    }
    place("message").textContent = words;
    state.current = p.i;
    refresh();
  }

  function saved() {
    const used = Object.values(ready).filter((b) => b.poles.some((p) => p.choice)).sort((a, b) => (a.id < b.id ? -1 : 1));
    const row = (b) => (p) => Object.assign({ block: b.id, order: p.order, index: p.index, frequency_hz: p.hz, damping_ratio: p.damping }, p.choice === "rejected" ? { reason: p.reason } : {});
    const all = (what) => used.flatMap((b) => chosen(what, b).map(row(b)));
    return { format: data.format, channels: data.head.channels, settings: data.head.settings,
             blocks: used.map((b) => b.head), picked: all("picked"), rejected: all("rejected") };
  }

  // --- the diagram ---------------------------------------------------------------------------------------------------
  function ticks(low, high, most) {
    const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
    const found = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) found.push(Math.abs(v) < 1e-9 * step ? 0 : v);
    return found.map((v) => [v, v.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−")]);
  }
  const MARK = [
    (x, y) => element("circle", { cx: x, cy: y, r: 3.2, fill: INK }),
    (x, y) => element("path", { d: `M${x - 3.6} ${y}h7.2M${x} ${y - 3.6}v7.2`, stroke: SOFT, "stroke-width": 1.3 }),
    (x, y) => element("circle", { cx: x, cy: y, r: 1.7, fill: "#9aa5b1" }),
  ];
  const CHOSEN = {
    picked: (x, y) => element("path", { d: `M${x} ${y - 7}l7 7l-7 7l-7 -7z`, fill: BLUE, stroke: "#fff", "stroke-width": 1.2 }),
    rejected: (x, y) => element("path", { d: `M${x - 5} ${y - 5}l10 10M${x + 5} ${y - 5}l-10 10`, stroke: RED, "stroke-width": 2.6 }),
  };

  function draw() {
    const b = block(), box = place("diagram"), width = box.clientWidth;
    if (!width) return;
    const height = Math.max(380, Math.min(540, 0.52 * width)), left = 46, right = 56, top = 46, bottom = 42;
    const x = (hz) => left + (hz - state.low) / (state.high - state.low) * (width - left - right);
    const most = Math.max(...b.poles.map((p) => p.order), 2) + 2;
    const y = (order) => height - bottom - order / most * (height - top - bottom);
    const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": `Stabilisation diagram of block ${b.id}: arrow keys move over the poles, Enter picks, Delete rejects` });
    const text = (value, at, more) => element("text", Object.assign({ x: at[0], y: at[1], "font-size": 12, fill: SOFT, "text-anchor": "middle" }, more), value);
    const inside = (hz) => hz >= state.low && hz <= state.high;
    b.bands.filter((band) => band[2] > state.low && band[1] < state.high).forEach(([name, low, high]) => {
      const from = Math.max(x(low), left), to = Math.min(x(high), width - right);
      svg.append(element("rect", { x: from, y: top, width: Math.max(to - from, 1), height: height - top - bottom, fill: "#6b7684", opacity: 0.16 }), text(name, [(from + to) / 2, height - bottom - 4], { "font-size": 11 }));
    });
    // singular values, in dB on the axis to the right
    const rows = b.lines.map((line) => line.map((v, k) => [k * b.line_hz, v]).filter(([hz, v]) => v !== null && hz > 0 && inside(hz)));
    const every = rows.flat().map((r) => r[1]);
    const ends = every.length ? [Math.floor(Math.min(...every) / 10) * 10, Math.ceil(Math.max(...every) / 10) * 10 + 5] : [0, 1];
    const db = (v) => height - bottom - (v - ends[0]) / (ends[1] - ends[0]) * (height - top - bottom);
    rows.forEach((row, k) => svg.append(element("polyline", { points: row.map(([hz, v]) => `${x(hz).toFixed(1)},${db(v).toFixed(1)}`).join(" "), fill: "none", stroke: ["#7fb0d3", "#a9c3b5", "#cfc2a4", "#d3c3cf"][k], "stroke-width": k ? 1 : 1.5 })));
    // axes
    const grid = { stroke: "#c3cad2", "stroke-width": 1 };
    svg.append(element("path", Object.assign({ d: `M${left} ${top}V${height - bottom}H${width - right}V${top}`, fill: "none" }, grid)));
    ticks(state.low, state.high, width < 600 ? 5 : 10).forEach(([v, words]) => svg.append(element("line", Object.assign({ x1: x(v), x2: x(v), y1: height - bottom, y2: height - bottom + 4 }, grid)), text(words, [x(v), height - bottom + 16])));
    ticks(0, most, 8).filter(([v]) => v > 0 && Number.isInteger(v)).forEach(([v, words]) => svg.append(text(words, [left - 6, y(v) + 4], { "text-anchor": "end" })));
    if (every.length) ticks(ends[0], ends[1], 6).forEach(([v, words]) => svg.append(text(words, [width - right + 6, db(v) + 4], { "text-anchor": "start" })));
    svg.append(text("frequency [Hz]", [(left + width - right) / 2, height - 6]),
               text("model order [-]", [0, 0], { transform: `translate(13 ${(top + height - bottom) / 2}) rotate(-90)` }),
               text(`${b.singular ? "singular values" : "sum of spectra"} [dB re 1 (${data.unit})²/Hz]`, [0, 0], { transform: `translate(${width - 8} ${(top + height - bottom) / 2}) rotate(-90)` }));
    // what was identified, and what is picked, as lines with their frequencies in rows that do not overlap
    const heads = [...b.modes.map(([label, hz]) => ({ hz, words: label, color: SOFT, dash: "5 4" })), ...chosen("picked", b).map((p) => ({ hz: p.hz, words: fixed(p.hz, digits(p.hz)), color: BLUE, dash: null }))].filter((h) => inside(h.hz)).sort((p, q) => p.hz - q.hz);
    const ended = [-99, -99, -99];
    heads.forEach((h) => {
      const at = x(h.hz), half = 3.6 * h.words.length, shelf = ended.findIndex((end) => at - half > end);
      svg.append(element("line", { x1: at, x2: at, y1: top, y2: height - bottom, stroke: h.color, "stroke-width": 1, "stroke-dasharray": h.dash, opacity: 0.8 }));
      if (shelf < 0) return;
      ended[shelf] = at + half + 4;
      svg.append(text(h.words, [at, top - 5 - 14 * shelf], { fill: h.color }));
    });
    const visible = b.poles.filter((p) => p.choice || (inside(p.hz) && p.steady <= ({ all: 2, near: 1, stable: 0 })[state.show] && (state.show === "all" || p.damping > 0))).filter((p) => inside(p.hz));
    if (!visible.some((p) => p.i === state.current)) state.current = visible.length ? (visible.find((p) => p.order >= b.chosen_order) || visible[0]).i : -1;
    const marks = {};
    visible.sort((p, q) => Boolean(p.choice) - Boolean(q.choice)).forEach((p) => {
      const at = [x(p.hz), y(p.order)];
      const g = element("g", { class: "pole", tabindex: p.i === state.current ? 0 : -1, role: "button", "aria-pressed": String(p.choice === "picked"), "aria-label": values(p).join(", "), "data-pole": p.i },
        element("circle", { cx: at[0], cy: at[1], r: 9, class: "ring" }), p.choice ? CHOSEN[p.choice](...at) : MARK[p.steady](...at));
      marks[p.i] = { g, at };
      svg.append(g);
    });
    drawn = { visible, marks, svg, width };
    const focused = box.contains(document.activeElement) && document.activeElement.closest(".pole");
    box.replaceChildren(svg, tip);
    if (focused && marks[state.current]) marks[state.current].g.focus({ preventScroll: true });
    showTip();
    const n = b.n - visible.length;
    place("counted").textContent = `${visible.length} of ${b.n} poles shown` + (n && state.show !== "all" ? "; stable ones with positive damping" : "");
  }

  const tip = element("div", { class: "tip", role: "tooltip" });
  function showTip() {
    const lit = state.hover >= 0 ? state.hover : place("diagram").contains(document.activeElement) ? state.current : -1;
    const mark = drawn.marks && drawn.marks[lit];
    tip.hidden = !mark;
    if (!mark) return;
    tip.replaceChildren(...values(block().poles[lit]).map((line, k) => element(k ? "div" : "strong", {}, line)));
    tip.style.left = "0";
    const w = tip.offsetWidth;
    tip.style.left = `${Math.max(4, Math.min(drawn.width - w - 4, mark.at[0] + (mark.at[0] > drawn.width / 2 ? -w - 14 : 14)))}px`;
    tip.style.top = `${Math.max(4, mark.at[1] - (drawn.width < 600 ? tip.offsetHeight + 14 : tip.offsetHeight / 2))}px`;
  }

  function nearest(event) {
    const r = drawn.svg.getBoundingClientRect(), px = event.clientX - r.left, py = event.clientY - r.top;
    let best = -1, least = Infinity;
    drawn.visible.forEach((p) => {
      const [u, v] = drawn.marks[p.i].at, away = Math.hypot(u - px, v - py);
      // of poles that lie upon one another the one that may be a mode
      const score = away + 2 * p.steady + (p.damping > 0 ? 0 : 4);
      if (away < 14 && score < least) { best = p.i; least = score; }
    });
    return best;
  }

  function goTo(i) {
    if (i < 0) return;
    const before = drawn.marks[state.current];
    if (before) before.g.setAttribute("tabindex", -1);
    state.current = i; state.hover = -1;
    drawn.marks[i].g.setAttribute("tabindex", 0);
    drawn.marks[i].g.focus({ preventScroll: true });
    showTip();
    shapes();
  }

  function moved(key) {
    const p = block().poles[state.current], those = drawn.visible;
    const side = { ArrowLeft: -1, ArrowRight: 1 }[key], rise = { ArrowUp: 1, ArrowDown: -1 }[key];
    if (side) {
      const row = those.filter((q) => q.order === p.order && (q.hz - p.hz) * side > 0).sort((a, c) => (a.hz - c.hz) * side);
      return row.length ? row[0].i : -1;
    }
    const orders = those.map((q) => q.order).filter((n) => (n - p.order) * rise > 0);
    const next = rise > 0 ? Math.min(...orders) : Math.max(...orders);
    const row = those.filter((q) => q.order === next).sort((a, c) => Math.abs(a.hz - p.hz) - Math.abs(c.hz - p.hz));
    return row.length ? row[0].i : -1;
  }

  function listen() {
    const box = place("diagram");
    box.addEventListener("pointermove", (e) => { const i = nearest(e); if (i !== state.hover) { state.hover = i; box.style.cursor = i >= 0 ? "pointer" : ""; showTip(); } });
    box.addEventListener("pointerleave", () => { state.hover = -1; showTip(); });
    box.addEventListener("click", (e) => {
      const i = nearest(e);
      if (i < 0) return;
      goTo(i);
      if (state.click !== "look") choose(block().poles[i], e.shiftKey ? "rejected" : state.click);
    });
    box.addEventListener("focusin", (e) => {
      const g = e.target.closest(".pole");
      if (g && Number(g.dataset.pole) !== state.current) goTo(Number(g.dataset.pole)); else showTip();
    });
    box.addEventListener("focusout", () => setTimeout(showTip, 0));
    box.addEventListener("keydown", (e) => {
      if (state.current < 0) return;
      const p = block().poles[state.current];
      if (e.key.startsWith("Arrow")) goTo(moved(e.key));
      else if (e.key === "Enter" || e.key === " ") choose(p, "picked");
      else if (e.key === "Delete" || e.key === "Backspace") choose(p, "rejected");
      else return;
      e.preventDefault();
    });
  }

  // --- controls ------------------------------------------------------------------------------------------------------
  function labelled(words, control) { return element("label", {}, words + " ", control); }
  function choiceOf(options, value, said, act) {
    const select = element("select", { "aria-label": said }, ...options.map(([key, words]) => element("option", { value: key }, words)));
    select.value = value;
    select.addEventListener("change", () => act(select.value));
    return select;
  }
  function button(words, act, more) { const b = element("button", Object.assign({ type: "button" }, more), words); b.addEventListener("click", act); return b; }

  function controls() {
    const bar = place("controls");
    const hz = (key, said) => {
      const input = element("input", { type: "number", step: "any", min: 0, max: data.highest_hz, value: +state[key].toFixed(4), "aria-label": said });
      input.addEventListener("change", () => {
        const value = Number(input.value), before = state[key];
        state[key] = Math.max(0, Math.min(data.highest_hz, value));
        if (!(state.high - state.low > 1e-4 * data.highest_hz)) state[key] = before;
        input.value = +state[key].toFixed(4);
        draw();
      });
      return input;
    };
    const from = hz("low", "lowest frequency shown, Hz"), to = hz("high", "highest frequency shown, Hz");
    const modes = element("span", { class: "modes", role: "group", "aria-label": "what a click does" });
    [["picked", "pick"], ["rejected", "reject"], ["look", "look only"]].forEach(([key, words]) => modes.append(button(words, () => { state.click = key; [...modes.children].forEach((c) => c.setAttribute("aria-pressed", String(c.dataset.click === key))); }, { "data-click": key, "aria-pressed": String(state.click === key) })));
    const reason = element("input", { type: "text", maxlength: 200, list: "reasons", placeholder: "reason, for rejecting", "aria-label": "reason for rejecting" });
    reason.addEventListener("input", () => { state.reason = reason.value; });
    bar.append(
      labelled("block", choiceOf(data.blocks.map((b) => [b.id, b.id]), state.block, "block", (id) => { state.block = id; state.current = -1; refresh(); })),
      labelled("poles", choiceOf([["all", "all"], ["near", "stable in f"], ["stable", "stable in all"]], state.show, "which poles are shown", (v) => { state.show = v; draw(); })),
      element("span", { class: "range" }, "from ", from, " to ", to, " Hz ", button("whole range", () => { state.low = 0; state.high = data.highest_hz; from.value = 0; to.value = +data.highest_hz.toFixed(4); draw(); })),
      element("span", {}, "a click: ", modes), reason,
      element("datalist", { id: "reasons" }, ...data.reasons.map((r) => element("option", { value: r }))),
      button("pick what was identified", () => { const b = block(); b.poles.forEach((p) => { if (p.mode && p.choice !== "rejected") p.choice = "picked"; }); place("message").textContent = `${chosen("picked", b).length} poles of block ${b.id} are picked`; refresh(); }, { id: "pick-proposed" }),
      button("clear block", () => { block().poles.forEach((p) => { p.choice = ""; }); place("message").textContent = `nothing is chosen in block ${state.block}`; refresh(); }));
  }

  function legend() {
    const mark = (inner) => element("svg", { width: 18, height: 16, "aria-hidden": "true" }, inner);
    const item = (inner, words) => element("span", {}, mark(inner), words);
    place("legend").append(
      ...STEADY.map((words, k) => item(MARK[k](9, 8), words)), item(CHOSEN.picked(9, 8), "picked as a mode"), item(CHOSEN.rejected(9, 8), "rejected"),
      item(element("path", { d: "M1 8h16", stroke: "#7fb0d3", "stroke-width": 2 }), block().singular ? "singular values of the spectral matrix, the largest darkest" : "sum of the spectral densities"),
      ...(data.blocks.some((b) => b.modes.length) ? [item(element("path", { d: "M9 0v16", stroke: SOFT, "stroke-dasharray": "4 3" }), "identified automatically")] : []),
      ...(data.blocks.some((b) => b.bands.length) ? [item(element("rect", { x: 3, y: 0, width: 12, height: 16, fill: "#6b7684", opacity: 0.25 }), "swept by a multiple of the rotor's speed")] : []));
  }

  // --- list, MAC, shapes ----------------------------------------------------------------------------------------------
  function table(caption, heads, rows) {
    return element("table", {}, element("caption", {}, caption), element("thead", {}, element("tr", {}, ...heads.map(([words, unit, kind]) => element("th", { scope: "col", class: kind || "number" }, words, unit ? element("span", { class: "unit" }, unit) : "")))), element("tbody", {}, ...rows));
  }
  const cell = (inside, kind) => element("td", { class: kind || "number" }, inside);

  function list() {
    const b = block(), rows = ["picked", "rejected"].flatMap((what) => chosen(what, b));
    const others = Object.values(ready).filter((o) => o !== b && o.poles.some((p) => p.choice));
    const content = saved(), link = place("save");
    const words = others.length ? ` Chosen in other blocks: ${others.map((o) => `${chosen("picked", o).length} picked and ${chosen("rejected", o).length} rejected in ${o.id}`).join("; ")}.` : "";
    place("list").replaceChildren(rows.length ? table(`Chosen in block ${b.id}`, [["frequency", "[Hz]"], ["std", "[Hz]"], ["damping", "[%]"], ["std", "[%]"], ["order", "[-]"], ["MPC", "[-]"], ["choice", "", "text"], ["reason", "", "text"]], rows.map((p) => {
      const reason = element("input", { type: "text", maxlength: 200, value: p.reason, "aria-label": `reason for rejecting ${fixed(p.hz, 3)} Hz` });
      reason.addEventListener("change", () => { p.reason = reason.value; refresh(); });
      return element("tr", {}, cell(fixed(p.hz, digits(p.hz, p.hz_std))), cell(p.hz_std ? fixed(p.hz_std, digits(p.hz, p.hz_std)) : "–"), cell(fixed(100 * p.damping, 2)), cell(p.damping_std ? fixed(100 * p.damping_std, 2) : "–"), cell(String(p.order)), cell(fixed(p.mpc, 3)), cell(button(p.choice, () => choose(p, p.choice), { "aria-label": `${p.choice}: ${fixed(p.hz, 3)} Hz, take back`, title: "take back" }), "text"), cell(p.choice === "rejected" ? reason : "", "text"));
    })) : element("p", {}, "Nothing is chosen in this block yet."), element("p", { class: "note" }, words));
    const can = content.picked.length > 0;
    link.textContent = can ? `Save the choice (${content.picked.length} picked, ${content.rejected.length} rejected)` : "Pick a pole to save a choice";
    link.classList.toggle("off", !can);
    link.setAttribute("aria-disabled", String(!can));
    if (can) link.href = "data:application/json;charset=utf-8," + encodeURIComponent(JSON.stringify(content, null, 1)); else link.removeAttribute("href");
    document.getElementById("pick-proposed").hidden = !b.modes.length;
  }

  function macs() {
    const b = block(), picked = chosen("picked", b), one = shownPole();
    const rows = one && !picked.includes(one) ? [...picked, one] : picked, name = (p) => `${fixed(p.hz, 3)} Hz`;
    place("mac").replaceChildren(picked.length ? element("table", { class: "mac" }, element("caption", {}, "MAC [-] of the picked modes"), element("thead", {}, element("tr", {}, element("th", {}), ...picked.map((p) => element("th", { scope: "col", class: "number" }, name(p))))), element("tbody", {}, ...rows.map((p) => element("tr", {}, element("th", { scope: "row" }, name(p) + (picked.includes(p) ? "" : " (not picked)")), ...picked.map((q) => {
      const v = mac(p.phi, q.phi), c = element("td", { class: "number" }, fixed(v, 2));
      c.style.background = `rgba(29,39,51,${(0.8 * v).toFixed(3)})`;
      c.style.color = v > 0.55 ? "#fff" : INK;
      return c;
    }))))) : element("p", {}, "The MAC matrix shows when modes are picked."));
  }

  function argand(p, words) {
    const size = 168, middle = size / 2, r = 58, at = ([u, v]) => [middle + r * u, middle - r * v];
    const svg = element("svg", { viewBox: `0 0 ${size} ${size + 20}`, width: size, height: size + 20, role: "img", "aria-label": `Components of the shape at ${fixed(p.hz, 3)} Hz on the complex plane, MPC ${fixed(p.mpc, 3)}` });
    const text = (t, x, y, anchor) => element("text", { x, y, "font-size": 11, fill: SOFT, "text-anchor": anchor || "middle" }, t);
    svg.append(element("circle", { cx: middle, cy: middle, r, fill: "none", stroke: "#d9dee4" }), element("path", { d: `M${middle - r - 6} ${middle}h${2 * r + 12}M${middle} ${middle - r - 6}v${2 * r + 12}`, stroke: "#c3cad2" }),
      text("Re [-]", size - 2, middle - 5, "end"), text("Im [-]", middle + 4, 12, "start"), text("1", middle + r - 3, middle + 13, "end"));
    p.phi.forEach((c, k) => svg.append(element("line", { x1: middle, y1: middle, x2: at(c)[0], y2: at(c)[1], stroke: p.choice === "picked" ? BLUE : SOFT, "stroke-width": 1.4 }), element("circle", { cx: at(c)[0], cy: at(c)[1], r: 2.6, fill: p.choice === "picked" ? BLUE : SOFT }, element("title", {}, `${data.channels[k]}: ${fixed(c[0], 3)} ${c[1] < 0 ? "−" : "+"} ${fixed(Math.abs(c[1]), 3)} i`))));
    svg.append(element("text", { x: middle, y: size + 13, "font-size": 12, fill: INK, "text-anchor": "middle" }, words));
    return svg;
  }

  function expanded(matrix, phi, k) {
    return Array.from({ length: matrix.length / 3 }, (_, node) => [0, 1, 2].map((i) => matrix[3 * node + i].reduce((sum, e, c) => sum + e * phi[c][k], 0)));
  }
  function shapes() {
    const b = block(), one = shownPole(), picked = chosen("picked", b);
    macs();
    const each = one && !picked.includes(one) ? [one, ...picked] : picked;
    place("argand").replaceChildren(...each.map((p) => argand(p, `${fixed(p.hz, 3)} Hz, MPC ${fixed(p.mpc, 2)}`)));
    const box = document.querySelector("[data-viewer]");
    place("shown").replaceChildren(...each.map((p) => button(`${fixed(p.hz, 3)} Hz${picked.includes(p) ? "" : `, order ${p.order}, not picked`}`, () => { state.hover = -1; state.current = p.i; draw(); shapes(); }, { "aria-pressed": String(p === one) })));
    if (!box || !box.viewer || !one) return;
    const wire = [0, 1].map((k) => expanded(data.node_matrix, one.phi, k)), points = [0, 1].map((k) => expanded(data.point_matrix, one.phi, k));
    const largest = Math.max(1e-12, ...wire[0].concat(points[0]).map((d) => Math.hypot(...d)));
    const scaled = (rows) => rows.map((d) => d.map((v) => v / largest));
    box.viewer.show({ label: `${fixed(one.hz, 3)} Hz`, name: `order ${one.order}, damping ${fixed(100 * one.damping, 2)} %`, variants: { measured: { hz: one.hz, shape: scaled(points[0]), shape_im: scaled(points[1]), wire: scaled(wire[0]), wire_im: scaled(wire[1]) } } });
  }

  function refresh() {
    place("notes").textContent = block().notes.join("; ");
    draw(); list(); shapes();
  }

  state.block = data.first;
  data.blocks.filter((b) => b.chosen.length).forEach((b) => opened(b.id));
  controls();
  legend();
  listen();
  if ("ResizeObserver" in window) new ResizeObserver(draw).observe(place("diagram"));
  refresh();
})();
