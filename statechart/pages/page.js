// The statechart, its active mode lit.
byId("diagram").innerHTML = data.chart.svg;
const nodes = new Map();
for (const node of byId("diagram").querySelectorAll("g.node")) {
  // A mode that a path passes again stands in it again.
  const name = node.querySelector("title").textContent.replace(/^_.*again_\d+_/, "");
  nodes.set(name, [...(nodes.get(name) ?? []), node]);
}
for (const name of data.chart.states) for (const node of nodes.get(name) ?? []) node.classList.add("state");
for (const title of byId("diagram").querySelectorAll("title")) title.remove();
// Beside the scene its letters stay legible; else it stands below, and scrolls away but on wide screens.
const chart = byId("diagram").firstElementChild;
// Graphviz shrinks large diagrams, and their letters; here they scroll.
const shrunk = chart ? Math.min(chart.querySelector("g").transform.baseVal.consolidate().matrix.a, 1) : 1;
for (const side of shrunk < 1 ? ["width", "height"] : []) chart.setAttribute(side, chart[side].baseVal.value / shrunk);
const least = chart ? 0.77 * chart.width.baseVal.value : 0;
byId("diagram").style.setProperty("--least", `${least}px`);
byId("diagram").style.setProperty("--lowest", `${chart ? 0.6 * chart.height.baseVal.value : 0}px`);
// Centre the active mode if the diagram is wider than the screen.
function centre() {
  const box = byId("diagram");
  const node = box.querySelector("g.lit");
  if (!node) return;
  const [there, here] = [node.getBoundingClientRect(), box.getBoundingClientRect()];
  box.scrollLeft += there.x + there.width / 2 - here.x - here.width / 2;
  box.scrollTop += there.y + there.height / 2 - here.y - here.height / 2;
}
function arrange() {
  const seen = document.querySelector(".seen");
  // The diagram gets two fifths of the width, less the gap.
  const beside = !film || (innerWidth > 760 && innerWidth < 1240 && least <= 0.4 * (seen.clientWidth - 16));
  // Moving an element resets its scroll position.
  if (beside && byId("diagram").parentNode !== seen) seen.append(byId("diagram"));
  if (!beside && byId("diagram").parentNode === seen) byId("stage").after(byId("diagram"));
  centre();
  document.documentElement.style.setProperty("--stuck", `${innerWidth < 1240 ? byId("stage").offsetHeight : 0}px`);
}
arrange();
addEventListener("resize", arrange);
const place = new Uint8Array(bytes(data.chart.place));
let lit = "";
moving.push((k) => {
  if (lit === `${mode[k]} ${place[k]}`) return;
  lit = `${mode[k]} ${place[k]}`;
  const active = new Set(data.chart.nodes[mode[k]]);
  for (const [name, those] of nodes) {
    // Of a mode that a path passes again the visit at hand.
    const here = those[place[k] % those.length];
    for (const node of those) node.classList.toggle("lit", active.has(name) && node === here);
  }
  centre();
});

// Curves with a cursor. Names have room on both sides, on narrow screens above.
const rows = data.regions.filter((region) => region.shown);
const unit = data.unit && ` ${data.unit}`;
const longest = (names) => 6.6 * Math.max(0, ...names.map((name) => name.length));
const fitted = (name, room) => {
  const most = Math.max(5, Math.floor(room / 6.6));
  const half = (most - 1) / 2;
  return name.length <= most ? name : `${name.slice(0, Math.ceil(half))}\u2026${name.slice(name.length - Math.floor(half))}`;
};
// A remark with fewer names and more in "3 more", until it fits; at last with their number.
const shortened = (remark, room) => {
  if (longest([remark]) <= room) return remark;
  const fewer = remark.replace(/, [^,;]+, (\d+) more/, (_, more) => `, ${+more + 1} more`);
  if (fewer !== remark) return shortened(fewer, room);
  return remark.replace(/: [^:]*$/, (names) => `: ${names.split(", ").reduce((sum, name) => sum + (parseInt(/^(\d+) more$/.exec(name)?.[1]) || 1), 0)}`);
};
const [above, high, number] = [20, 138, 70];
const span = times[last] || 1;
const cursors = [];
const values = [];
let [wide, left, right] = [1000, 64, 860];
const along = (t) => left + ((right - left) * t) / span;
for (const panel of data.panels) {
  panel.t = float(panel.t);
  panel.curves = panel.curves.map(float);
  panel.cone = panel.cone && float(panel.cone);
  panel.colours = panel.colours.map((colour) => (colour === "#000000" ? "var(--ink)" : colour));
  for (const hit of panel.struck) for (const what of ["t", "sizes"]) hit[what] = float(hit[what]);
  panel.entries = panel.names.map((name, i) => ({ name, colour: panel.colours[i] }));
  if (panel.cone) panel.entries.push({ name: "\u00b1\u03bcV, the cone", colour: "var(--faint)", dashed: true });
  panel.struck.forEach((hit, i) => panel.entries.push({ name: hit.name, colour: panel.names.length ? "var(--accent)" : data.lines[i], mark: panel.names.length ? "M-4 0L0 -8L4 0Z" : "M-3.5 -4a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0" }));
  panel.entries.forEach((those, i) => { those.values = panel.curves[i]; });
}
const timeOf = (svg, event) => {
  const box = svg.getBoundingClientRect();
  return (span * (((event.clientX - box.left) / box.width) * wide - left)) / (right - left);
};
function axes(height) {
  const svg = made(byId("curves"), "svg", { viewBox: `0 0 ${wide} ${height}` });
  svg.addEventListener("click", (event) => go(at(timeOf(svg, event))));
  svg.addEventListener("pointermove", (event) => {
    const t = timeOf(svg, event);
    if (t < 0 || t > span) return;
    for (const cursor of cursors) {
      cursor.hover.style.display = "";
      for (const x of ["x1", "x2"]) cursor.hover.setAttribute(x, along(t));
    }
    read(t);
  });
  svg.addEventListener("pointerleave", () => {
    for (const cursor of cursors) cursor.hover.style.display = "none";
    read(times[now]);
  });
  return svg;
}
function cursor(parent, y1, y2) {
  const line = (style) => made(parent, "line", { y1, y2, style });
  const found = line("stroke: var(--accent); stroke-width: 1.5");
  found.hover = line("stroke: var(--faint); stroke-width: 1; display: none");
  cursors.push(found);
}
// Values of curves at a time, between the points that they are drawn by.
function read(t) {
  for (const { panel, curve, text } of values) {
    let [low, high] = [0, panel.t.length - 1];
    while (low < high) {
      let middle = (low + high + 1) >> 1;
      while (middle < high && !Number.isFinite(panel.t[middle])) middle++;
      if (panel.t[middle] <= t * (1 + 1e-7)) low = middle;
      else high = ((low + high + 1) >> 1) - 1;
    }
    const [a, b] = [panel.t[low], panel.t[low + 1]];
    const part = b > a ? Math.min(1, Math.max(0, (t - a) / (b - a))) : 0;
    const value = part > 0 ? curve[low] + part * (curve[low + 1] - curve[low]) : curve[low];
    // Round-off of what is drawn shows as zero.
    text.textContent = Number.isFinite(value) ? level(Math.abs(value) < 1e-12 * panel.size ? 0 : value, 4) : "";
  }
}
function named(parent, attributes, name, room) {
  const text = made(parent, "text", attributes, fitted(name, room));
  if (text.textContent !== name) made(text, "title", {}, name);
}
function entry(svg, { name, colour, dashed, mark }, x, y, room) {
  if (mark) made(svg, "path", { d: mark, transform: `translate(${x + 9} ${y})`, style: `fill: ${colour}` });
  else made(svg, "line", { x1: x, x2: x + 18, y1: y - 4, y2: y - 4, style: `stroke: ${colour}; stroke-width: ${dashed ? 1 : 2.5}; ${dashed ? "stroke-dasharray: 4 3" : ""}` });
  named(svg, { x: x + 24, y }, name, room);
}
function drawn(panel, narrow) {
  const places = [];
  let [x, y] = [left, above + 6];
  const room = narrow ? right - left - 24 - number : wide - right - 40 - number;
  for (const { name, values } of panel.entries) {
    const size = Math.min(longest([name]), room) + 34 + (values ? number : 0);
    if (narrow && x > left && x + size > right) [x, y] = [left, y + 15];
    places.push(narrow ? [x, y] : [right + 14, above + 8 + 15 * places.length]);
    x += size;
  }
  const free = narrow ? right - left : right - left - longest([panel.title]) - 30;
  const remarks = panel.remarks.map((remark) => shortened(remark, narrow ? free : free / panel.remarks.length));
  const lower = narrow ? y - above + 6 + 15 * remarks.length : 0;
  const svg = axes(Math.max(high, narrow ? 0 : above + 4 + 15 * places.length) + 6 + lower);
  panel.entries.forEach((those, i) => {
    entry(svg, those, ...places[i], room);
    if (!those.values) return;
    const [x, y] = places[i];
    const begin = x + 34 + Math.min(longest([those.name]), room);
    const text = made(svg, "text", { class: "value", y, ...(narrow ? { x: begin } : { x: wide - 4, "text-anchor": "end" }) });
    values.push({ panel, curve: those.values, text });
  });
  named(svg, { x: left, y: above - 9, style: "font-weight: 600" }, panel.title, right - left);
  (narrow ? remarks.toReversed() : [remarks.join("; ")]).forEach((remark, i) =>
    named(svg, { x: right, y: above - 9 + lower - 15 * i, "text-anchor": "end", style: "fill: var(--faint)" }, remark, free));
  const plot = made(svg, "g", lower ? { transform: `translate(0 ${lower})` } : {});
  const seen = [...panel.curves, ...panel.struck.map((hit) => hit.sizes)];
  const finite = seen.flatMap((v) => Array.from(v)).filter(Number.isFinite);
  let [low, most] = [Math.min, Math.max].map((best) => finite.reduce((a, b) => best(a, b), 0));
  panel.size = Math.max(-low, most);
  if (panel.cone) {
    const edge = Array.from(panel.cone).filter(Number.isFinite).reduce((a, b) => Math.max(a, b), 0);
    const reach = Math.min(edge, 2 * Math.max(-low, most));
    [low, most] = [Math.min(low, -reach), Math.max(most, reach)];
  }
  const scale = (high - above - 6) / (most - low || 1);
  const up = (v) => above + (most - v) * scale;
  for (const v of ticks(low, most, 4)) {
    made(plot, "line", { class: "tick", x1: left, x2: right, y1: up(v), y2: up(v), style: `stroke: var(--${v ? "grid" : "faint"}); stroke-width: 1` });
    made(plot, "text", { x: left - 6, y: up(v) + 4, "text-anchor": "end" }, level(v));
  }
  for (const t of ticks(0, span, narrow ? 5 : 10)) made(plot, "line", { class: "tick", x1: along(t), x2: along(t), y1: above - 6, y2: high, style: "stroke: var(--grid); stroke-width: 1" });
  const line = (v, style) => {
    let d = "";
    let pen = false;
    for (let i = 0; i < panel.t.length; i++) {
      const y = up(v[i]);
      // A cone much wider than the force ends at the edge of its panel.
      if (!Number.isFinite(panel.t[i]) || !(y >= above - 6 && y <= high)) pen = false;
      else {
        d += `${pen ? "L" : "M"}${along(panel.t[i]).toFixed(1)} ${y.toFixed(1)}`;
        pen = true;
      }
    }
    made(plot, "path", { d, style: `fill: none; ${style}` });
  };
  if (panel.cone) for (const sign of [1, -1]) line(panel.cone.map((v) => sign * v), "stroke: var(--faint); stroke-dasharray: 4 3");
  panel.curves.forEach((v, i) => line(v, `stroke: ${panel.colours[i]}; stroke-width: 1.6`));
  panel.struck.forEach((hit, i) => {
    const [foot, sized] = [up(0), hit.sizes.length > 0];
    const [d, dot] = ["", ""].map((_, part) => Array.from(hit.t, (t, k) => {
      const [x, y] = [along(t).toFixed(1), up(sized ? hit.sizes[k] : 0).toFixed(1)];
      if (sized) return part ? `M${x} ${y}l0 0` : `M${x} ${foot.toFixed(1)}L${x} ${y}`;
      return part ? "" : `M${x - 3.5} ${(foot - 1).toFixed(1)}l3.5 -6l3.5 6z`;
    }).join(""));
    const colour = sized ? data.lines[i] : "var(--accent)";
    made(plot, "path", { class: "struck", d, style: sized ? `stroke: ${colour}; stroke-width: 1.2` : `fill: ${colour}` });
    if (sized) made(plot, "path", { d: dot, style: `stroke: ${colour}; stroke-width: 5; stroke-linecap: round` });
  });
  cursor(plot, above - 6, high);
}
function bands(narrow) {
  const captions = [data.unit ? `t in ${data.unit}` : "t", ...(data.cut ? [`no change until the end at ${short(data.end)}${unit}`] : []), ...data.unbanded.map((remark) => shortened(remark, right - 8))];
  const svg = axes(18 * rows.length + 22 + 15 * captions.length);
  rows.forEach((region, row) => {
    named(svg, { x: left - 6, y: 18 * row + 13, "text-anchor": "end" }, region.name, left - 8);
    for (let k = 0; k <= last; ) {
      let end = k;
      while (end < last && region.state[end + 1] === region.state[k]) end++;
      const [from, to] = [along(times[k]), along(times[Math.min(end + 1, last)])];
      const band = made(svg, "rect", { x: from, width: Math.max(to - from, 0), y: 18 * row + 2, height: 14, fill: region.colours[region.state[k]] });
      made(band, "title", {}, region.states[region.state[k]]);
      k = end + 1;
    }
  });
  const foot = 18 * rows.length + 16;
  for (const t of ticks(0, span, narrow ? 5 : 10)) {
    const anchor = along(t) > right - 10 ? "end" : "middle";
    made(svg, "line", { class: "tick", x1: along(t), x2: along(t), y1: foot - 13, y2: foot - 9, style: "stroke: var(--faint); stroke-width: 1" });
    made(svg, "text", { x: along(t), y: foot, "text-anchor": anchor }, level(t));
  }
  captions.forEach((line, i) => named(svg, { x: right, y: foot + 15 + 15 * i, "text-anchor": "end", style: i ? "fill: var(--faint)" : "" }, line, right - 8));
  cursor(svg, 0, 18 * rows.length);
}
function drawCurves() {
  byId("curves").replaceChildren();
  cursors.length = values.length = 0;
  const there = byId("curves").clientWidth;
  const narrow = there < 700;
  wide = narrow ? Math.max(there, 280) : 1000;
  const names = data.panels.flatMap((panel) => panel.entries.map((those) => those.name));
  left = Math.min(Math.max(narrow ? 48 : 64, longest(rows.map((region) => region.name)) + 12), wide / 5);
  right = narrow ? wide - 8 : Math.max(Math.min(800, 956 - number - longest(names)), 680);
  for (const panel of data.panels) drawn(panel, narrow);
  bands(narrow);
  return there;
}
let drawnFor = drawCurves();
// A frame of a notebook may get its width after it was loaded.
new ResizeObserver(() => {
  const there = byId("curves").clientWidth;
  if (there === drawnFor || Math.min(there, drawnFor) >= 700) return;
  drawnFor = drawCurves();
  go(now);
}).observe(byId("curves"));
moving.push((k) => {
  for (const cursor of cursors) for (const x of ["x1", "x2"]) cursor.setAttribute(x, along(times[k]));
  read(times[k]);
});

// Numbers.
byId("doc").textContent = data.doc;
byId("outcome").textContent = data.outcome;
for (const line of data.computed) made(byId("computed"), "li", {}, line);
for (const warning of data.warnings) made(byId("warnings"), "p", {}, warning);
// What speed costs in accuracy.
byId("study").hidden = !data.study;
if (data.study) {
  byId("figure").src = `data:image/svg+xml;base64,${data.study.figure}`;
  for (const part of ["above", "below"]) for (const line of data.study[part]) made(byId(part), "li", {}, line);
  data.study.rows.forEach((cells, k) => {
    const row = made(byId("settings"), "tr", data.study.own.includes(k) ? { class: "own", title: "the setting of this run" } : {});
    for (const cell of cells) made(row, k ? "td" : "th", {}, cell);
  });
}
for (const name of ["outputs", "parameters"])
  for (const [key, value] of Object.entries(data[name])) {
    const row = made(byId(name), "tr");
    made(made(row, "td"), "div", { class: "name" }, key);
    const { text, values: many } = value;
    const box = made(made(row, "td"), "div", { class: "value" }, text);
    const known = many.filter(Number.isFinite);
    if (known.length < 2) continue;
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const spot = (v, i) => `${(1 + (118 * i) / (many.length - 1)).toFixed(1)} ${(17 - (14 * (v - low)) / (high - low || 1)).toFixed(1)}`;
    const points = many.map((v, i) => (Number.isFinite(v) ? spot(v, i) : "")).filter(Boolean);
    made(made(box, "svg", { class: "spark", width: 120, height: 20 }), "path", { d: `M${points.join("L")}` });
  }
for (const [name, part] of [["happened", data.events], ["measured", Object.keys(data.outputs)], ["chosen", Object.keys(data.parameters)]])
  byId(name).hidden = part.length === 0;
let explained;
function explain(event) {
  explained = event;
  byId("why").replaceChildren();
  made(byId("why"), "p", {}, event ? event.why.replaceAll("->", "\u2192") : "Choose an event.");
  const table = made(byId("why"), "table");
  for (const [head, those] of event ? event.reasons : []) {
    const row = made(table, "tr");
    made(row, "th", {}, head);
    const within = made(made(row, "td"), "table");
    for (const cells of those) {
      const line = made(within, "tr");
      cells.forEach((cell, i) => {
        const kind = /^ *-?\d\S*$/.test(cell) ? "number" : i < cells.length - 1 ? "name" : "";
        made(made(line, "td"), "div", { class: kind }, cell);
      });
    }
  }
}
const lines = data.events.map((event) => {
  const row = made(byId("events").tBodies[0], "tr", { tabindex: 0 });
  made(row, "td", { title: event.t }, short(event.t));
  made(row, "td", {}, event.what);
  made(row, "td", {}, event.change.replaceAll("->", "\u2192"));
  const choose = () => {
    pause();
    go(event.instant);
    explain(event);
  };
  row.addEventListener("click", choose);
  row.addEventListener("keydown", (pressed) => pressed.key === "Enter" && choose());
  return row;
});
if (data.more) byId("more").textContent = `${data.more} more: the command line has all, with --json`;
moving.push((k) => {
  lines.forEach((row, i) => row.classList.toggle("now", data.events[i].instant === k));
  const past = data.events.findLast((event) => event.instant <= k);
  if (past !== explained || !byId("why").firstChild) explain(past);
});

// The clock: an instant is a number, and all that is seen belongs to it.
const slider = byId("slider");
slider.max = span;
let now = 0;
let playing = 0;
function at(t) {
  let [low, high] = [0, last];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle;
    else high = middle - 1;
  }
  return low;
}
function go(k) {
  now = k;
  for (const move of moving) move(k);
  slider.value = times[k];
  byId("time").textContent = `t = ${short(times[k])}${unit}`;
  const pills = byId("mode");
  pills.replaceChildren();
  pills.dataset.mode = data.regions.map((region) => `${region.name}:${region.states[region.state[k]]}`).join(" ");
  for (const [label, colour] of pillsOf(k)) made(pills, "span", { style: `background: ${colour}` }, label);
}
// Of more regions than have a row those that are alike are counted.
function pillsOf(k) {
  const said = (region) => [`${region.name}: ${region.states[region.state[k]]}`, region.colours[region.state[k]]];
  if (!data.unbanded.length) return rows.map(said);
  const groups = new Map();
  for (const region of data.regions) {
    const kind = region.states.join();
    if (!groups.has(kind)) groups.set(kind, []);
    groups.get(kind).push(region);
  }
  return [...groups.values()].flatMap((those) => those.length === 1 ? [said(those[0])] : those[0].states.flatMap((state, i) => {
    const count = those.filter((region) => region.state[k] === i).length;
    return count ? [[`${state}: ${count} of ${those.length}`, those[0].colours[i]]] : [];
  }));
}
const icon = (d) => byId("icon").setAttribute("d", d);
icon("M7 4l13 8-13 8z");
const pause = () => {
  cancelAnimationFrame(playing);
  playing = 0;
  icon("M7 4l13 8-13 8z");
};
byId("play").addEventListener("click", () => {
  if (playing) return pause();
  if (now === last) go(0);
  icon("M6 4h4v16h-4zM14 4h4v16h-4z");
  const [from, began] = [times[now], performance.now()];
  const speed = Number(byId("speed").value);
  const step = (clock) => {
    const t = from + (speed * Math.max(0, clock - began)) / 1000;
    const k = at(t);
    if (k !== now) go(k);
    if (k === last) return pause();
    playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
});
// It keeps 15 digits of where it is.
const slid = () => at(Number(slider.value) * (1 + 1e-12));
slider.addEventListener("input", () => { pause(); go(slid()); });
byId("speed").addEventListener("change", pause);
const usual = span >= 3 && span <= 10 ? 1 : 10 ** Math.round(Math.log10(span / 6));
for (const factor of [0.1, 0.2, 0.5, 1, 2, 5, 10]) {
  const speed = Number((usual * factor).toPrecision(3));
  const option = made(byId("speed"), "option", { value: speed }, `\u00d7 ${speed}`);
  option.selected = factor === 1;
}
go(0);
